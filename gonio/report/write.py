"""Which file becomes which report?  A scan, with or without a facade result, or the latter alone."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

from gonio.errors import ConfigError, StoreError
from gonio.report import style
from gonio.report.content import read_content
from gonio.report.facade_page import facade_page, facade_sections
from gonio.report.page import Page, make_folder, write_page
from gonio.report.scan_page import scan_page

if TYPE_CHECKING:
    from gonio.facade import Irradiance

PAGE = "report.html"
FACADE_TYPE = "gonio facade simulation"


def write_report(scan_h5: Path, out_dir: Path, *, facade_h5: Path | None = None) -> Path:
    """Write the report of a scan: ``report.html``, and each figure as PNG and SVG under ``figures/``.

    Parameters
    ----------
    scan_h5
        A scan file, finished or not, with or without fits, sphere and truth stored in it.
    out_dir
        Folder to write into; made if missing, files of an earlier report in it are replaced.
    facade_h5
        A facade result to show on the same page.

    Returns
    -------
    Path
        The page, which needs no other file and no network.

    Raises
    ------
    StoreError
        A file cannot be read as what it should be, or the folder cannot be written.
    """
    content = read_content(Path(scan_h5))
    irradiance = _load_irradiance(Path(facade_h5)) if facade_h5 is not None else None
    figures = make_folder(Path(out_dir))
    with style.styled():
        sections = facade_sections(irradiance, figures) if irradiance is not None else []
        page = scan_page(content, figures, sections)
    return write_page(page, Path(out_dir) / PAGE)


def write_facade_report(facade_h5: Path, out_dir: Path) -> Path:
    """Write the report of a facade result alone and return its page; raises like `write_report`."""
    irradiance = _load_irradiance(Path(facade_h5))
    figures = make_folder(Path(out_dir))
    with style.styled():
        page: Page = facade_page(irradiance, Path(facade_h5), figures)
    return write_page(page, Path(out_dir) / PAGE)


def write_any_report(file_h5: Path, out_dir: Path, *, facade_h5: Path | None = None) -> Path:
    """Write the report of a scan or of a facade result, whichever it is; raises like `write_report`."""
    if not is_facade(Path(file_h5)):
        return write_report(file_h5, out_dir, facade_h5=facade_h5)
    if facade_h5 is not None:
        raise ConfigError(
            f"{file_h5}: is itself a facade result; give a scan file first, or leave --facade out"
        )
    return write_facade_report(file_h5, out_dir)


def is_facade(path: Path) -> bool:
    """Say whether a file is a facade result; `StoreError` if it is no HDF5 file at all."""
    from gonio.store.checked import Checked
    from gonio.store.read import opened

    with opened(path, "r") as file:
        parts = Checked(path, file)
        if not (parts.has("entry") and parts.has("entry/experiment_type")):
            return False
        return parts.text("entry/experiment_type") == FACADE_TYPE


def _load_irradiance(path: Path) -> Irradiance:
    from gonio.facade import load_irradiance  # compiled code comes with it: only when there is one to show

    irradiance = load_irradiance(path)
    if not irradiance.receivers:
        raise StoreError(f"{path}: holds no receiver to show; simulate the scene again with gonio facade")
    return irradiance

"""The parts of the NeXus file that are known before the first reading: entry, sample, instrument.

Vocabulary of NXoptical_spectroscopy where it has a word; there is no NeXus definition for a BRDF.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import h5py
import numpy as np
from numpy.typing import NDArray

from gonio.aperture import Aperture
from gonio.plan.model import Plan
from gonio.store.layout import COLUMNS
from gonio.store.records import ScanHeader

END_TIME_BYTES = 40
"""Room for a time with microseconds and its zone."""


def text_dataset(group: h5py.Group, name: str, value: str) -> None:
    """Write a string of any length; HDF5 has no zero bytes in it."""
    value = value.replace("\x00", "\N{SYMBOL FOR NULL}")
    group.create_dataset(name, data=value, dtype=h5py.string_dtype("utf-8"))


def text_list(group: h5py.Group, name: str, values: Sequence[str] | None, what: str) -> None:
    """Write strings and what they are; None makes an empty list that grows."""
    dtype = h5py.string_dtype("utf-8")
    if values is None:
        dataset = group.create_dataset(name, (0,), dtype=dtype, maxshape=(None,))
    else:
        dataset = group.create_dataset(name, data=list(values), dtype=dtype)
    dataset.attrs["quantity"] = what


def quantity(group: h5py.Group, name: str, value: Any, units: str, what: str) -> h5py.Dataset:
    """Write a number or array with its unit and what it is."""
    dataset = group.create_dataset(name, data=value)
    dataset.attrs["units"] = units
    dataset.attrs["quantity"] = what
    return dataset


def nexus_group(parent: h5py.Group, name: str, nx_class: str) -> h5py.Group:
    """Make a group of a NeXus class."""
    group = parent.create_group(name)
    group.attrs["NX_class"] = nx_class
    return group


def write_entry(file: h5py.File, header: ScanHeader, plan: Plan) -> h5py.Group:
    """Write `/entry` but for its data, and return it; `scan_status` is ``unfinished`` until the end."""
    file.attrs["NX_class"] = "NXroot"
    file.attrs["default"] = "entry"
    file.attrs["creator"] = header.program
    file.attrs["file_time"] = header.start_time
    file.attrs["HDF5_Version"] = h5py.version.hdf5_version
    file.attrs["h5py_version"] = h5py.version.version
    entry = nexus_group(file, "entry", "NXentry")
    entry.attrs["default"] = "data"
    entry.attrs["scan_status"] = "unfinished"
    for name, value in (
        ("title", plan.title),
        ("start_time", header.start_time),
        ("program", header.program),
        ("plan", header.plan_text),
        ("rig", header.rig_text),
        ("experiment_type", "reflection spectroscopy"),
        ("angle_reference_frame", "sample-normal centered"),
    ):
        text_dataset(entry, name, value)
    # A name that is added later changes three places of the file, and a process that dies between them leaves
    # one that does not open; so the end has its place from the start, to be written over.
    entry.create_dataset("end_time", data=b"", dtype=h5py.string_dtype("utf-8", END_TIME_BYTES))
    sample = nexus_group(entry, "sample", "NXsample")
    text_dataset(sample, "name", plan.sample.name)
    text_dataset(sample, "description", plan.sample.description)
    _write_instrument(entry, header)
    return entry


def _write_instrument(entry: h5py.Group, header: ScanHeader) -> None:
    rig = header.rig
    instrument = nexus_group(entry, "instrument", "NXinstrument")
    text_dataset(instrument, "name", rig.name)
    text_dataset(instrument, "angle_reference_frame", "sample-normal centered")
    quantity(
        instrument, "angle_of_in_plane_sample_rotation", 0.0, "deg", "the sample is not turned in its plane"
    )
    for role, answer in header.devices.items():
        part = nexus_group(instrument, f"{role}_identity", "NXfabrication")
        text_dataset(part, "model", answer)

    aperture = nexus_group(instrument, "aperture", "NXaperture")
    text_dataset(aperture, "description", "rectangle")  # shape has no word for it in NeXus
    quantity(aperture, "width", rig.width_mm, "mm", "width in the plane of incidence")
    quantity(aperture, "height", rig.height_mm, "mm", "height across the plane of incidence")
    quantity(aperture, "distance", rig.distance_mm, "mm", "distance from the sample's surface")
    omega = Aperture(rig.width_mm, rig.height_mm, rig.distance_mm).solid_angle_sr
    quantity(aperture, "solid_angle", omega, "sr", "solid angle of the centred rectangle")

    monochromator = nexus_group(instrument, "monochromator", "NXmonochromator")
    text_dataset(monochromator, "description", header.devices.get("monochromator", ""))
    for detector in rig.detectors:
        group = nexus_group(instrument, f"detector_{detector.name}", "NXdetector")
        text_dataset(group, "local_name", detector.name)
        text_dataset(group, "detector_type", detector.type)
        text_dataset(group, "detector_channel_type", "single-channel")
        quantity(
            group, "wavelength_range", [detector.low_nm, detector.high_nm], "nm", "wavelengths it is used for"
        )
        quantity(group, "distance", rig.distance_mm, "mm", "distance from the sample's surface")
        quantity(group, "solid_angle", omega, "sr", "solid angle of the aperture")

    polarizer = nexus_group(instrument, "polarizer", "NXpolarizer")
    text_dataset(polarizer, "type", "linear, rotated")
    quantity(polarizer, "s_angle", rig.s_deg, "deg", "rotator angle that transmits s")
    quantity(polarizer, "p_angle", rig.p_deg, "deg", "rotator angle that transmits p")

    source = nexus_group(instrument, "source", "NXsource")
    text_dataset(source, "name", "lamp")  # which, the rig file may say
    text_dataset(source, "probe", "photon")
    beam = nexus_group(instrument, "beam_incident", "NXbeam")
    instrument["beam"] = beam  # the same group under the shorter name
    text_dataset(beam, "description", "beam on the sample; its direct signal is the 100 % baseline")
    size = rig.beam
    if size is not None:
        quantity(beam, "width", size.width_mm, "mm", "width across the beam, in the plane of incidence")
        quantity(beam, "height", size.height_mm, "mm", "height out of the plane of incidence")
        quantity(beam, "divergence", size.divergence_deg, "deg", "full angle of a uniform square cone")
    quantity(
        beam, "baseline_theta_i", rig.baseline_theta_i_deg, "deg", "sample angle of the baseline reading"
    )
    quantity(
        beam,
        "baseline_theta_mes",
        rig.baseline_theta_mes_deg,
        "deg",
        "detector angle of the baseline reading",
    )


def link_instrument(entry: h5py.Group, detector_index: NDArray[np.uint8], names: Sequence[str]) -> None:
    """Give the instrument what `/entry/data` holds of it, under the names of NXoptical_spectroscopy.

    Angles, wavelengths and positions are the same datasets (hard links); the raw signal of each detector is a
    view of its columns (virtual dataset), so that nothing is stored twice.
    """
    data, instrument = entry["data"], entry["instrument"]
    instrument["angle_of_incidence"] = data["theta_i"]
    instrument["angle_of_detection"] = data["theta_o"]
    instrument["monochromator/wavelength"] = data["wavelength"]
    instrument["beam_incident/incident_wavelength"] = data["wavelength"]
    source = data["raw_signal"]
    for number, name in enumerate(names):
        columns = np.flatnonzero(detector_index == number)
        if len(columns) == 0:
            continue  # the plan has no wavelength of its
        low, high = int(columns[0]), int(columns[-1]) + 1  # a detector's wavelengths stand together
        group = nexus_group(instrument[f"detector_{name}"], "raw_data", "NXdata")
        group.attrs["signal"] = "raw"
        group.attrs["axes"] = ["position", "wavelength"]
        group.attrs["position_indices"] = 0
        group.attrs["wavelength_indices"] = 1
        layout = h5py.VirtualLayout(shape=(source.shape[0], high - low), dtype=source.dtype)
        layout[...] = h5py.VirtualSource(".", source.name, shape=source.shape)[:, low:high]
        group.create_virtual_dataset("raw", layout, fillvalue=np.nan)
        group["raw"].attrs.update(COLUMNS["raw_signal"].attributes())
        group["position"] = data["position"]
        quantity(group, "wavelength", data["wavelength"][low:high], "nm", COLUMNS["wavelength"].quantity)

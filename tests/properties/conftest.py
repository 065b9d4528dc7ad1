"""Makes the fuzzing harness of `benchmarks/fuzzing`, which is no installed package, importable here."""

from __future__ import annotations

import importlib.util
import sys
from pathlib import Path

_PACKAGE = Path(__file__).parents[2] / "benchmarks" / "fuzzing"


def _load() -> None:
    spec = importlib.util.spec_from_file_location(
        "fuzzing", _PACKAGE / "__init__.py", submodule_search_locations=[str(_PACKAGE)]
    )
    assert spec is not None
    assert spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    sys.modules["fuzzing"] = module
    spec.loader.exec_module(module)


if "fuzzing" not in sys.modules:
    _load()

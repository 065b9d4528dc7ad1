"""The bench in memory and its plan as fixtures."""

from __future__ import annotations

import importlib.util
import sys
from pathlib import Path
from types import ModuleType

import pytest

from gonio.plan import Plan, parse_plan

sys.path.insert(0, str(Path(__file__).parent))  # tests are no package; helper modules are found beside them
_PATH = Path(__file__).with_name("memory_rig.py")


@pytest.fixture(scope="session")
def memory() -> ModuleType:
    spec = importlib.util.spec_from_file_location("gonio_test_memory_rig", _PATH)
    assert spec is not None
    assert spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    sys.modules[spec.name] = module  # its dataclasses look themselves up there
    spec.loader.exec_module(module)
    return module


@pytest.fixture
def plan(memory: ModuleType) -> Plan:
    return parse_plan(memory.PLAN_TOML)

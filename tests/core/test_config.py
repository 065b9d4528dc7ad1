"""Every mistake in a user's file becomes one clear line."""

from __future__ import annotations

from pathlib import Path

import pytest

from gonio.config import Positive, Strict, parse_toml, read_toml, validate
from gonio.errors import ConfigError


class Sweep(Strict):
    theta_i_deg: float
    step_deg: Positive = 3.0


class File(Strict):
    title: str
    sweeps: tuple[Sweep, ...] = ()


def message(table: dict[str, object]) -> str:
    with pytest.raises(ConfigError) as caught:
        validate(File, table, source="plan.toml")
    return str(caught.value)


def test_unknown_key_is_named_with_the_nearest_known_one() -> None:
    text = message(
        {"title": "x", "sweeps": [{"theta_i_deg": 20.0}, {"theta_i_rad": 0.3, "theta_i_deg": 1.0}]}
    )
    assert text.startswith("plan.toml: sweeps[2].theta_i_rad is an unknown key; did you mean 'theta_i_deg'?")


def test_missing_key() -> None:
    assert message({}) == "plan.toml: title is missing; add it"


@pytest.mark.parametrize("value", [0.0, -3.0, "3", True, float("nan"), float("inf")])
def test_a_number_must_be_a_positive_finite_number(value: object) -> None:
    text = message({"title": "x", "sweeps": [{"theta_i_deg": 20.0, "step_deg": value}]})
    assert text.startswith("plan.toml: sweeps[1].step_deg")
    assert repr(value) in text


def test_every_mistake_is_listed() -> None:
    text = message({"titel": "x", "sweeps": [{}]})
    assert len(text.splitlines()) == 3
    assert "did you mean 'title'?" in text


def test_toml_syntax_error_names_the_line() -> None:
    with pytest.raises(ConfigError, match="line 2"):
        parse_toml('title = "x"\n== 3\n', source="plan.toml")


def test_missing_and_binary_files(tmp_path: Path) -> None:
    with pytest.raises(ConfigError, match="no such file"):
        read_toml(tmp_path / "nowhere.toml")
    (tmp_path / "binary.toml").write_bytes(b"\xff\xfe\x00")
    with pytest.raises(ConfigError, match="cannot be read"):
        read_toml(tmp_path / "binary.toml")
    with pytest.raises(ConfigError, match="cannot be read"):
        read_toml(tmp_path)

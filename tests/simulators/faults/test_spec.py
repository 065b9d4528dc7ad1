"""What a specification says, and what is said of one that says nothing sensible."""

from __future__ import annotations

import pytest

from gonio.errors import ConfigError
from gonio_simulators.faults import CATALOGUE, fault_table, parse_fault
from gonio_simulators.faults.places import places_of

# fmt: off
NAMES = {
    "slow-reply", "dropped-reply", "late-reply", "dropped-request", "hang", "garbage",
    "corrupt-reply", "corrupt-request", "split-reply", "doubled-reply", "disconnect",
    "echo-missing", "echo-doubled", "alarm", "limit", "stall", "knob", "power-cycle",
    "detector-saturated", "lockin-overload", "lamp-drift", "lamp-out", "detector-change",
    "filter-stuck", "grating-stuck", "shutter-stuck", "wavelength-stuck",
}
# fmt: on


def test_names_are_promises() -> None:
    assert set(CATALOGUE) == NAMES
    table = fault_table()
    assert all(f"\n{name}: " in table for name in NAMES)


@pytest.mark.parametrize(
    ("text", "target", "mode", "value"),
    [
        ("late-reply:0.01", None, "probability", 0.01),
        ("stall@theta_mes:nth=3", "theta_mes", "nth", 3.0),
        ("alarm@stage:every=10", "stage", "every", 10.0),
        ("lamp-out:at=12.5", None, "at", 12.5),
        ("hang@lockin:rate=0.5", "lockin", "rate", 0.5),
    ],
)
def test_name_target_and_when(text: str, target: str | None, mode: str, value: float) -> None:
    spec = parse_fault(text)
    assert (spec.target, spec.when.mode, spec.when.value) == (target, mode, value)


def test_keys_have_defaults_and_types() -> None:
    spec = parse_fault("split-reply:1:size=3")
    assert dict(spec.options) == {"size": 3, "gap_s": 0.005}
    spec = parse_fault("alarm:nth=1:cause=encoder:part=0.25:hold_s=0")
    assert dict(spec.options) == {"cause": "encoder", "part": 0.25, "hold_s": 0.0}
    assert parse_fault("stall:nth=1:silent=true").options["silent"] is True


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("lat-reply:0.1", ["no fault 'lat-reply'", "did you mean 'late-reply'", "echo-missing"]),
        ("late-reply", ["WHEN is missing", "nth=K"]),
        ("late-reply:", ["the probability = '' is not a number"]),
        ("late-reply@:0.1", ["target after '@' is missing"]),
        ("late-reply:1.5", ["1.5", "0...1"]),
        ("late-reply:nan", ["nan", "not a number"]),
        ("late-reply:nth=0", ["nth = 0", "whole number"]),
        ("late-reply:every=2.5", ["every = 2.5"]),
        ("late-reply:at=-1", ["at = -1", "below 0"]),
        ("late-reply:rate=often", ["rate = 'often'"]),
        ("late-reply:often=3", ["'often=3' does not say when"]),
        ("hang:0.1:hangs=3", ["no key 'hangs'", "did you mean 'hang_s'"]),
        ("dropped-reply:0.1:size=3", ["dropped-reply has no keys"]),
        ("hang:0.1:hang_s", ["'hang_s' is not KEY=VALUE"]),
        ("hang:0.1:hang_s=inf", ["not a number"]),
        ("hang:0.1:hang_s=-1", ["hang_s = -1", "0..."]),
        ("garbage:0.1:size=1.5", ["size = 1.5", "whole"]),
        ("garbage:0.1:place=inside", ["place = inside", "there are: before, within"]),
        ("stall:0.1:silent=yes", ["silent = yes", "true nor false"]),
    ],
)
def test_a_wrong_specification_is_one_message(text: str, words: list[str]) -> None:
    with pytest.raises(ConfigError) as caught:
        parse_fault(text)
    for word in (f"fault '{text}'", *words):
        assert word in str(caught.value)


@pytest.mark.parametrize(
    ("text", "places"),
    [
        ("late-reply:0.1", ("stage", "polarizer", "monochromator", "lockin")),
        ("late-reply@lockin:0.1", ("lockin",)),
        ("echo-missing:0.1", ("monochromator",)),
        ("stall:0.1", ("theta_i", "theta_mes", "polarizer")),
        ("stall@stage:0.1", ("theta_i", "theta_mes")),
        ("limit:0.1", ("theta_i", "theta_mes")),
        ("detector-saturated:0.1", ("pmt", "ingaas")),
        ("detector-change@pmt:0.1", ("pmt",)),
        ("lamp-out:0.1", ("lamp",)),
    ],
)
def test_places(text: str, places: tuple[str, ...]) -> None:
    assert places_of(parse_fault(text), ["pmt", "ingaas"]) == places


@pytest.mark.parametrize(
    ("text", "words"),
    [
        (
            "late-reply@theta_i:0.1",
            ["does not apply to 'theta_i'", "stage, polarizer, monochromator, lockin"],
        ),
        ("limit@polarizer:0.1", ["does not apply to 'polarizer'", "stage, theta_i, theta_mes"]),
        ("stall@theta:0.1", ["did you mean 'theta_i'"]),
        ("detector-change@pbs:0.1", ["pmt, ingaas"]),
    ],
)
def test_a_target_it_does_not_apply_to(text: str, words: list[str]) -> None:
    with pytest.raises(ConfigError) as caught:
        places_of(parse_fault(text), ["pmt", "ingaas"])
    for word in words:
        assert word in str(caught.value)

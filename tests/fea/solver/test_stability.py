"""Extreme parts and loads: each is answered right or refused by name, none wrong in silence."""

import numpy as np
import pytest

from tests.fea import stability

BOUNDS = {
    "rubber block": 0.03,
    "rubber block, hex20": 0.07,
    "two-material bar": 1e-11,
    "thin cantilever, linear": 2e-4,
    "thin cantilever, 15 degrees": 5e-4,
    "guided bar": 1e-9,
    "pure moment": 0.007,
    "one element thick": 0.015,
    "shallow arch": 0.015,
    "spring": 0.005,
}
"""The most that an answer called right may be off."""

BOUNDS_OF_SETTINGS = {"ratio 1e+09, stiff outer half": 1e-9}
"""Where roundoff decides: 1e9 times it is 2e-7. Over eight orders of elimination the stiff half on
the soft one was right to between 7e-14 (cut just between the two) and 3e-10."""


def rows_of(name):
    rows = stability.CASES[name]()
    for row in rows:
        if row.outcome == "right":
            assert row.error < BOUNDS_OF_SETTINGS.get(row.setting, BOUNDS[row.case]), row
        else:
            assert row.told, row
    return {row.setting: row.outcome for row in rows}


def test_rubber_is_right_in_hex27_and_refused_where_hex20_would_lock():
    outcomes = rows_of("incompressible")
    assert outcomes.pop("hex20 nu 0.4999") == "locking_material"
    assert len(outcomes) == 8
    assert set(outcomes.values()) == {"right"}


def test_every_contrast_of_stiffness_is_right():
    assert set(rows_of("contrast").values()) == {"right"}


def test_thin_parts_are_right_down_to_one_in_a_thousand():
    assert set(rows_of("thinness").values()) == {"right"}


def test_loads_from_a_billionth_to_a_billion_newtons_are_right_or_buckle_by_name():
    outcomes = rows_of("magnitudes")
    assert outcomes.pop("-1e+09 N") == "snap_through"
    assert len(outcomes) == 23
    assert set(outcomes.values()) == {"right"}


def test_a_pure_moment_is_right_up_to_twenty_degrees_and_refused_beyond():
    for setting, outcome in rows_of("pure_moment").items():
        degrees = float(setting.split()[0])
        assert outcome == ("right" if degrees < 20 else "rotation_too_large")


def test_one_element_across_is_right_or_a_mechanism_by_name():
    outcomes = rows_of("one_element")
    assert outcomes.pop("hex20 reduced, 1 x 1 across") == "mechanism"
    assert set(outcomes.values()) == {"right"}


def test_an_arch_is_right_below_its_limit_and_named_above():
    outcomes = rows_of("snap_through")
    assert list(outcomes.values()) == ["right", "snap_through"] * 2


def test_the_spring_is_right_in_its_guide_and_named_without_it():
    outcomes = rows_of("spring")
    assert outcomes["1 N, guided"] == outcomes["10 N, guided"] == "right"
    assert outcomes["10 N, unguided"] in {"rotation_too_large", "snap_through"}


@pytest.mark.parametrize("strain", [1e-12, -1e-5, 1e-3, 0.3, -0.15])
def test_the_closed_form_of_the_guided_bar_solves_its_equation(strain):
    stretch = 1 + stability.extension(strain)
    e = stretch - 1
    assert stretch * (e + e * e / 2) == pytest.approx(strain, rel=1e-10)
    assert np.isnan(stability.extension(-0.2))

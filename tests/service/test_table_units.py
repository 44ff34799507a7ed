from __future__ import annotations

import math
from decimal import Decimal

import pytest

from tests.refusals import assert_told, cases
from wrenchbook.service.formats.cells import (
    FORCE,
    MOMENT,
    ROTATION,
    TRANSLATION,
    UnitError,
    chosen_units,
    si_factor,
)

LBF = 0.45359237 * 9.80665  # N, exact by definition


@pytest.mark.parametrize(
    ("unit", "quantity", "factor"),
    [
        ("N", FORCE, 1.0),
        ("kN", FORCE, 1e3),
        ("daN", FORCE, 10.0),
        ("lbf", FORCE, LBF),
        ("kgf", FORCE, 9.80665),
        ("kip", FORCE, 1000 * LBF),
        ("newton", FORCE, 1.0),
        ("mm", TRANSLATION, 1e-3),
        ("um", TRANSLATION, 1e-6),
        ("µm", TRANSLATION, 1e-6),  # micro sign
        ("μm", TRANSLATION, 1e-6),  # Greek mu
        ("in", TRANSLATION, 0.0254),
        ("thou", TRANSLATION, 0.0254e-3),
        ("rad", ROTATION, 1.0),
        ("mrad", ROTATION, 1e-3),
        ("deg", ROTATION, math.pi / 180),
        ("°", ROTATION, math.pi / 180),
        ("arcmin", ROTATION, math.pi / 180 / 60),
    ],
)
def test_units_of_test_benches_have_their_value(unit, quantity, factor):
    assert float(si_factor(unit, quantity)) == pytest.approx(factor, rel=1e-15)


@pytest.mark.parametrize(
    "unit", ["Nm", "N m", "N*m", "N·m", "N⋅m", "N-m", "N.m", "N × m", "m·N", "m N"]
)
def test_every_way_to_write_a_newton_metre_is_one(unit: str):
    # Pint alone takes Nm for a textile count and N-m for a subtraction.
    assert si_factor(unit, MOMENT) == 1.0


@pytest.mark.parametrize(
    ("unit", "factor"),
    [
        ("kNm", 1e3),
        ("Nmm", 1e-3),
        ("mNm", 1e-3),
        ("N-mm", 1e-3),
        ("kN·mm", 1.0),
        ("Ncm", 1e-2),
        ("lbf*in", LBF * 0.0254),
        ("in-lbf", LBF * 0.0254),
        ("ft lbf", LBF * 0.3048),
        ("lbf·ft", LBF * 0.3048),
    ],
)
def test_moments_are_products_however_they_are_joined(unit: str, factor: float):
    assert float(si_factor(unit, MOMENT)) == pytest.approx(factor, rel=1e-15)


@cases(__file__, "units")
def test_a_unit_that_does_not_fit_says_what_to_write(case):
    quantity = {one.name: one for one in (FORCE, MOMENT, ROTATION, TRANSLATION)}[case["quantity"]]
    with pytest.raises(UnitError) as caught:
        si_factor(case["unit"], quantity)
    assert_told(case, [str(caught.value)])
    assert len(str(caught.value)) < 200


def test_a_unit_of_5000_letters_is_told_in_a_line():
    with pytest.raises(UnitError, match="is not a unit that can be read") as caught:
        si_factor("N" * 5000, FORCE)
    assert len(str(caught.value)) < 200


def test_units_of_an_export_are_si_unless_chosen():
    assert chosen_units({"force": "lbf"})[FORCE] == ("lbf", 4.4482216152605)
    assert chosen_units(None)[TRANSLATION] == ("m", 1.0)
    with pytest.raises(UnitError, match="no unit can be chosen for torque; there are force"):
        chosen_units({"torque": "N*m"})


def test_a_factor_is_the_float_nearest_to_the_decimal_number_that_defines_it():
    exact = Decimal("0.45359237") * Decimal("9.80665") * Decimal("0.0254")
    assert si_factor("lbf*in", MOMENT) == float(exact)
    assert si_factor("thou", TRANSLATION) == 0.0000254
    assert si_factor("deg", ROTATION) == math.pi / 180

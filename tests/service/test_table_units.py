from __future__ import annotations

import math
from decimal import Decimal

import pytest

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


@pytest.mark.parametrize(
    ("unit", "quantity", "says"),
    [
        ("mm", FORCE, "[mm] is not a unit of force; a force takes for example N, kN, lbf, kgf"),
        ("lb", FORCE, "lb is a mass; write lbf"),
        ("ft-lb", MOMENT, "lb is a mass; write lbf"),
        ("kg", FORCE, "kg is a mass; write kgf"),
        ("nm", MOMENT, "upper and lower case differ: did you mean [N*m]?"),
        ("MM", TRANSLATION, "did you mean [mm]?"),
        ("mil", TRANSLATION, "mil is an angle to a unit library; write thou"),
        ("percent", ROTATION, "[percent] is not a unit of rotation"),
        ("degC", ROTATION, "not a unit of rotation"),
        ("N", MOMENT, "a moment takes for example N*m"),
        ("quatsch", FORCE, "the unit [quatsch] is not known"),
        ("", FORCE, "is not a unit that can be read"),
        ("1", ROTATION, "is not a unit that can be read"),
        ("N/m", FORCE, "is not a unit that can be read"),
        ("10**10**10", FORCE, "is not a unit that can be read"),
        ("__import__('os')", FORCE, "is not a unit that can be read"),
        ("N" * 5000, FORCE, "is not a unit that can be read"),
        ("dBm", FORCE, "[dBm]"),
    ],
)
def test_a_unit_that_does_not_fit_says_what_to_write(unit, quantity, says):
    with pytest.raises(UnitError) as caught:
        si_factor(unit, quantity)
    assert says in str(caught.value)
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

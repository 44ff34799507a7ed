"""The first natural frequency that a mount's server tells, and what is carried lowers."""

import warnings

import numpy as np
import pytest

from tests.service.client.answers import TOLERANCE, bar_compliance, client_with
from wrenchbook.service.client.mount import Mount, MountWarning
from wrenchbook.service.client.mount.mount import first_frequency


def told(frequency):
    facts = {"has_fea": True, "tolerance": TOLERANCE, "vibration": {"first_frequency": frequency}}
    return client_with(
        component=lambda _: facts,
        compliance=lambda _: {"matrix": bar_compliance().tolist()},
    )


def made(source, **options):
    return Mount(source, "bar", np.eye(3), np.zeros(3), **options)


def test_a_mass_on_a_weightless_bar_swings_as_in_closed_form():
    compliance, mass = bar_compliance(), np.diag([7.0, 7.0, 7.0, 0.0, 0.0, 0.0])
    expected = 1 / (2 * np.pi * np.sqrt(7.0 * compliance[2, 2]))
    assert first_frequency(None, compliance, mass) == pytest.approx(expected, rel=1e-12)


def test_the_server_tells_the_frequency_where_the_ramp_alone_is_given():
    with pytest.warns(MountWarning, match="2.7 periods of its first natural frequency, 27 Hz"):
        made(told(27.0), ramp_time=0.1)
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        made(told(27.0), ramp_time=0.3)


def test_what_is_carried_lowers_the_frequency():
    with pytest.warns(MountWarning, match="rings"):
        made(told(27.0), ramp_time=0.3, carried=10.0)


def test_a_component_without_any_mass_is_said_to_be_unknown():
    source = told(27.0)
    source.component = lambda _: {"has_fea": True, "tolerance": TOLERANCE, "vibration": None}
    with pytest.warns(MountWarning, match="no density"):
        made(source, ramp_time=0.1)

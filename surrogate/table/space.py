"""The inputs and outputs of a table: names, units and kinds.

A component with one interface has the default space: a wrench of six loads, a displacement of six
outputs. With several interfaces each has six loads and six outputs; temperature and acceleration
are further inputs.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass
from functools import cached_property
from itertools import chain, combinations
from math import comb
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray

Floats = NDArray[np.float64]

InputKind = Literal["force", "moment", "scalar"]

# Spelling of the contract, for keys and lists. Messages and texts say F_x and u_x.
LOADS = ("fx", "fy", "fz", "mx", "my", "mz")
LOAD_UNITS = ("N", "N", "N", "N·m", "N·m", "N·m")
OUTPUTS = ("ux", "uy", "uz", "rx", "ry", "rz")
PER_INTERFACE = len(LOADS)
OUTPUT_UNITS = ("m", "m", "m", "rad", "rad", "rad")


_UNNAMED = "the component has one interface, without a name: give its wrench as force and moment"


def axis_inputs(axis: int) -> tuple[int, int, int]:
    """Return the indices of an axis' loads: a force, and the moments about the other axes."""
    return axis, 3 + (axis + 1) % 3, 3 + (axis + 2) % 3


class SpaceError(ValueError):
    """Inputs that do not fit a space; `mistakes` has the field and the text of each."""

    def __init__(self, mistakes: Sequence[tuple[str, str]]) -> None:
        super().__init__("; ".join(f"{place}: {text}" for place, text in mistakes))
        self.mistakes = mistakes


@dataclass(frozen=True)
class Input:
    """One input of a table."""

    name: str  # unique in its space: ``fx``, ``left.fx``, ``temperature``
    unit: str  # SI
    kind: InputKind
    interface: str = ""  # where a load acts; empty for scalars, and where there is one interface
    zero: float = 0.0  # value without an effect, in its unit; for a temperature the reference


@dataclass(frozen=True)
class Output:
    """One output of a table, a translation in m or a rotation in rad; see `Input`."""

    name: str
    unit: str
    interface: str = ""


@dataclass(frozen=True)
class Space:
    """The inputs and outputs of a table."""

    inputs: tuple[Input, ...]
    outputs: tuple[Output, ...]  # each interface has six, in the order of `OUTPUTS`

    @property
    def is_default(self) -> bool:
        """Whether the space is that of one interface without further inputs."""
        return self == DEFAULT

    @cached_property
    def input_names(self) -> tuple[str, ...]:
        """The names of the inputs."""
        return tuple(entry.name for entry in self.inputs)

    @cached_property
    def output_names(self) -> tuple[str, ...]:
        """The names of the outputs."""
        return tuple(output.name for output in self.outputs)

    @cached_property
    def interfaces(self) -> tuple[str, ...]:
        """The names of the interfaces in their order; one empty name for a single interface."""
        return tuple(dict.fromkeys(output.interface for output in self.outputs))

    @cached_property
    def scalars(self) -> tuple[Input, ...]:
        """The further inputs, which are no loads and come after the loads."""
        return tuple(entry for entry in self.inputs if entry.kind == "scalar")

    @cached_property
    def several(self) -> tuple[str, ...]:
        """The names of the interfaces if there are several, else none."""
        return self.interfaces if len(self.interfaces) > 1 else ()

    @property
    def curvatures(self) -> int:
        """The number of third derivatives by k inputs, k (k + 1) (k + 2) / 6: 56 for six."""
        return comb(len(self.inputs) + 2, 3)

    @cached_property
    def zero(self) -> Floats:
        """The values of inputs without an effect, shape (n,), in their units; zero for loads."""
        return np.array([entry.zero for entry in self.inputs])

    @cached_property
    def is_rotation(self) -> NDArray[np.bool_]:
        """Which outputs are rotations, shape (m,)."""
        return np.array([output.unit == "rad" for output in self.outputs])

    @cached_property
    def kriging_groups(self) -> Floats:
        """Which inputs each additive term of the kriging depends on, shape (g, n): 1 or 0.

        The last term depends on all. One interface has a term for each of its three axes (straight
        direction influence); several have one for each interface and each pair. Scalars are in
        every term: a load's effect depends on the temperature.
        """
        scalars = {index for index, entry in enumerate(self.inputs) if entry.kind == "scalar"}
        by_interface = [
            {index for index, entry in enumerate(self.inputs) if entry.interface == name} - scalars
            for name in self.interfaces
        ]
        if len(by_interface) == 1:
            terms = [set(axis_inputs(axis)) for axis in range(3)]
        else:
            pairs = combinations(by_interface, 2) if len(by_interface) > 2 else ()
            terms = [*by_interface, *(first | second for first, second in pairs)]
        groups = [*(term | scalars for term in terms), set(range(len(self.inputs)))]
        return np.array([[float(k in term) for k in range(len(self.inputs))] for term in groups])

    def vector(
        self, loads: Mapping[str, Sequence[float]], further: Mapping[str, float]
    ) -> tuple[float, ...]:
        """Return inputs in their order, shape (n,), SI; loads that are not given are zero.

        `loads`: six numbers for each interface, by its name, N and N·m.
        `further`: all further inputs, by name.

        Raises SpaceError if a name is unknown, or a further input is missing.
        """
        known = " or ".join(filter(None, self.interfaces))
        names = [scalar.name for scalar in self.scalars]
        no_interface = f"no such interface; use {known}" if known else _UNNAMED
        use = f"use {' or '.join(names)}" if names else "the component has none; leave it out"
        no_input = f"no such input; {use}"
        mistakes = [
            *((f"loads.{name}", no_interface) for name in loads if name not in self.interfaces),
            *((f"inputs.{name}", no_input) for name in further if name not in names),
            *(
                (
                    f"inputs.{scalar.name}",
                    f"missing; give its value in {scalar.unit} (--input {scalar.name}=NUMBER)",
                )
                for scalar in self.scalars
                if scalar.name not in further
            ),
        ]
        if mistakes:
            raise SpaceError(mistakes)
        zero = (0.0,) * PER_INTERFACE
        wrenches = (loads.get(name, zero) for name in self.interfaces)
        return (*chain.from_iterable(wrenches), *(further[name] for name in names))

    def by_name(self, inputs: Sequence[float]) -> dict[str, Any]:
        """Return the named inputs of a vector, shape (n,), SI: the inverse of `vector`.

        The entry ``loads`` has ``{"force": three, "moment": three}`` by interface, or without a
        name for a single interface; ``inputs`` has the further inputs by name, if there are any.
        """
        loads = {
            name: {"force": inputs[k : k + 3], "moment": inputs[k + 3 : k + PER_INTERFACE]}
            for name, k in zip(self.interfaces, range(0, len(inputs), PER_INTERFACE), strict=False)
        }
        first = len(self.inputs) - len(self.scalars)
        further = dict(zip((scalar.name for scalar in self.scalars), inputs[first:], strict=True))
        result: dict[str, Any] = {"loads": loads} if self.several else loads[self.interfaces[0]]
        return result | ({"inputs": further} if further else {})

    def largest_of_kind(self, values: Floats) -> Floats:
        """Return, for each output, the largest of its kind, translations or rotations.

        Values and result have shape (m,), in the outputs' units.
        """
        rotation = self.is_rotation
        largest = np.empty(len(self.outputs))
        for kind in (rotation, ~rotation):
            largest[kind] = values[kind].max(initial=-np.inf)
        return largest

    def as_json(self) -> dict[str, Any]:
        """Return the space as JSON-able values for `read`."""
        return {
            "inputs": [_filled(asdict(entry)) for entry in self.inputs],
            "outputs": [_filled(asdict(output)) for output in self.outputs],
        }

    @classmethod
    def read(cls, description: Mapping[str, Any]) -> Space:
        """Return the space of `as_json`'s values."""
        inputs = tuple(Input(**entry) for entry in description["inputs"])
        return cls(inputs, tuple(Output(**entry) for entry in description["outputs"]))


def _filled(entries: dict[str, Any]) -> dict[str, Any]:
    return {name: value for name, value in entries.items() if value}


def space_of(interfaces: Sequence[str] = ("",), scalars: Sequence[Input] = ()) -> Space:
    """Return the space of interfaces and further inputs.

    `interfaces`: their names, the prefixes of the names of their loads: ``left.fx``.
    """
    inputs: list[Input] = []
    outputs: list[Output] = []
    for name in interfaces:
        front = f"{name}." if name else ""
        for index in range(PER_INTERFACE):
            kind: InputKind = "force" if index < 3 else "moment"
            inputs.append(Input(front + LOADS[index], LOAD_UNITS[index], kind, name))
            outputs.append(Output(front + OUTPUTS[index], OUTPUT_UNITS[index], name))
    return Space((*inputs, *scalars), tuple(outputs))


DEFAULT = space_of()
"""One interface, no further inputs."""

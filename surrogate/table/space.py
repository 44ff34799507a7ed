"""The inputs and outputs of a table: names, units and kinds.

A component with one interface has the default space: a wrench of six loads, a displacement of six
outputs. Several interfaces have six of each an interface; temperature and acceleration are further
inputs.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass
from functools import cached_property
from itertools import combinations
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray

Floats = NDArray[np.float64]

InputKind = Literal["force", "moment", "scalar"]

# As the contract spells them: keys and lists. Sentences for people say F_x and u_x.
LOADS = ("fx", "fy", "fz", "mx", "my", "mz")
LOAD_UNITS = ("N", "N", "N", "N·m", "N·m", "N·m")
OUTPUTS = ("ux", "uy", "uz", "rx", "ry", "rz")
OUTPUT_UNITS = ("m", "m", "m", "rad", "rad", "rad")


@dataclass(frozen=True)
class Input:
    """One input of a table.

    Attributes
    ----------
    name : str
        Unique in its space: ``fx``, ``left.fx``, ``temperature``.
    unit : str
        SI.
    kind : {"force", "moment", "scalar"}
    interface : str
        Where a load acts; empty for scalars, and where there is one interface.
    """

    name: str
    unit: str
    kind: InputKind
    interface: str = ""


@dataclass(frozen=True)
class Output:
    """One output of a table, a translation in m or a rotation in rad; see `Input`."""

    name: str
    unit: str
    interface: str = ""


@dataclass(frozen=True)
class Space:
    """The inputs and outputs of a table.

    Attributes
    ----------
    inputs : tuple of Input
    outputs : tuple of Output
        Each interface has six, in the order of `OUTPUTS`.
    """

    inputs: tuple[Input, ...]
    outputs: tuple[Output, ...]

    @property
    def is_default(self) -> bool:
        """Whether it is that of one interface without further inputs."""
        return self == DEFAULT

    @cached_property
    def input_names(self) -> tuple[str, ...]:
        """The names of the inputs."""
        return tuple(one.name for one in self.inputs)

    @cached_property
    def output_names(self) -> tuple[str, ...]:
        """The names of the outputs."""
        return tuple(one.name for one in self.outputs)

    @cached_property
    def interfaces(self) -> tuple[str, ...]:
        """The names of the interfaces in their order; an empty one where there is one."""
        return tuple(dict.fromkeys(one.interface for one in self.outputs))

    @cached_property
    def is_rotation(self) -> NDArray[np.bool_]:
        """Which outputs are rotations, shape (m,)."""
        return np.array([one.unit == "rad" for one in self.outputs])

    @cached_property
    def kriging_groups(self) -> Floats:
        """Which inputs each additive term of the kriging sees, shape (g, n): 1 or 0.

        The last term sees all. One interface has a term each of its three axes (straight direction
        influence); several have one an interface and one a pair. Scalars are in every term: what a
        load does depends on the temperature.
        """
        return self._groups

    @cached_property
    def _groups(self) -> Floats:
        scalars = {place for place, one in enumerate(self.inputs) if one.kind == "scalar"}
        own = [
            {place for place, one in enumerate(self.inputs) if one.interface == name} - scalars
            for name in self.interfaces
        ]
        if len(own) == 1:
            terms = [{i, 3 + (i + 1) % 3, 3 + (i + 2) % 3} for i in range(3)]
        else:
            pairs = combinations(own, 2) if len(own) > 2 else ()
            terms = [*own, *(one | other for one, other in pairs)]
        seen = [*(term | scalars for term in terms), set(range(len(self.inputs)))]
        return np.array([[float(k in term) for k in range(len(self.inputs))] for term in seen])

    def largest_of_kind(self, values: Floats) -> Floats:
        """Return, for each output, the largest of its kind, translations or rotations.

        Values and result have shape (m,), in the outputs' units.
        """
        rotation, found = self.is_rotation, np.empty(len(self.outputs))
        for kind in (rotation, ~rotation):
            found[kind] = values[kind].max(initial=-np.inf)
        return found

    def words(self) -> dict[str, Any]:
        """Return the space as JSON, which `read` takes."""
        return {
            "inputs": [_filled(asdict(one)) for one in self.inputs],
            "outputs": [_filled(asdict(one)) for one in self.outputs],
        }

    @classmethod
    def read(cls, words: Mapping[str, Any]) -> Space:
        """Return the space of its JSON."""
        inputs = tuple(Input(**one) for one in words["inputs"])
        return cls(inputs, tuple(Output(**one) for one in words["outputs"]))


def _filled(entries: dict[str, str]) -> dict[str, str]:
    return {name: text for name, text in entries.items() if text}


def space_of(interfaces: Sequence[str] = ("",), scalars: Sequence[Input] = ()) -> Space:
    """Return the space of interfaces and further inputs.

    Parameters
    ----------
    interfaces : sequence of str
        Their names, which stand before the names of their loads: ``left.fx``.
    scalars : sequence of Input
    """
    inputs: list[Input] = []
    outputs: list[Output] = []
    for name in interfaces:
        front = f"{name}." if name else ""
        for place in range(6):
            kind: InputKind = "force" if place < 3 else "moment"
            inputs.append(Input(front + LOADS[place], LOAD_UNITS[place], kind, name))
            outputs.append(Output(front + OUTPUTS[place], OUTPUT_UNITS[place], name))
    return Space((*inputs, *scalars), tuple(outputs))


DEFAULT = space_of()
"""One interface, no further inputs."""

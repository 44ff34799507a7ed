"""The commands ``joint`` (a part in a MuJoCo scene) and ``stiffness`` (a part as a matrix)."""

from __future__ import annotations

import json
import sys
from pathlib import Path
from typing import Annotated, Any

import typer
from rich.table import Table

from wrenchbook.service.cli.connect import (
    DEFAULT_SERVER,
    ZERO,
    AsJson,
    Data,
    FurtherInput,
    Name,
    Server,
    Three,
    connected,
    further_inputs,
    in_folder,
    refuse_alone,
)
from wrenchbook.service.cli.render import matrix_table, print_json, show, stiffness_lines
from wrenchbook.service.client.joint import LinearPart
from wrenchbook.service.client.joint.joint import DAMPING, FREEDOMS

_Force = Annotated[
    Three, typer.Option(help="force about which the part is linear, N", metavar="FX FY FZ")
]
_Moment = Annotated[
    Three, typer.Option(help="moment about which the part is linear, N·m", metavar="MX MY MZ")
]


def joint(
    name: Name,
    scene: Annotated[
        Path, typer.Argument(help="MJCF file of the scene", exists=True, dir_okay=False)
    ],
    base: Annotated[str, typer.Option(help="body on the support's side")] = "base",
    tip: Annotated[str, typer.Option(help="body on the interface's side, its child")] = "tip",
    interface: Annotated[
        str | None, typer.Option(help="interface at the tip, of a part with several")
    ] = None,
    site: Annotated[
        str | None,
        typer.Option(
            help="site on the tip with the point and frame of the interface; by default the tip"
        ),
    ] = None,
    massless: Annotated[
        bool, typer.Option("--massless", help="do not add the part's own mass to the tip")
    ] = False,
    linear: Annotated[
        bool,
        typer.Option(
            "--linear", help="write springs into the scene, which bend without MujocoJoint"
        ),
    ] = False,
    damping: Annotated[
        float,
        typer.Option(min=0.0, help="with --linear: fraction of critical damping of each mode"),
    ] = DAMPING,
    force: _Force = ZERO,
    moment: _Moment = ZERO,
    further: FurtherInput = None,
    out: Annotated[
        Path | None, typer.Option(help="write to this file, not to stdout", callback=in_folder)
    ] = None,
    as_json: AsJson = False,
    server: Server = DEFAULT_SERVER,
    data: Data = None,
) -> None:
    """Write a MuJoCo scene in which a component can bend between two bodies, for MujocoJoint."""
    if not linear:  # MujocoJoint takes damping, inputs and loads itself
        of_springs = {"--damping": damping != DAMPING, "--input": further}
        of_springs |= {"--force": force != ZERO, "--moment": moment != ZERO}
        refuse_alone("--linear", of_springs)
    # Imported on use: no other command needs MuJoCo's scenes.
    from wrenchbook.service.client.joint.mujoco_model import scene_with_joint, scene_with_springs

    with connected(server, data) as client:
        facts = client.component(name)
        table = client.download(name) if linear else None
    body, mass = _tip_interface(name, facts, interface)
    if massless:
        mass = None
    if table is None:
        locked = body.get("locked", ())
        text = scene_with_joint(scene, base, tip, locked=locked, site=site, mass=mass)
    else:
        springs = LinearPart.of(table, (*force, *moment), further_inputs(further))
        text = scene_with_springs(scene, base, tip, springs, damping=damping, site=site, mass=mass)
        sys.stderr.write(f"{springs.error}\n")
    if not massless:
        sys.stderr.write(_mass_note(name, facts, mass, tip) + "\n")

    if out is not None:
        out.write_text(text, encoding="utf-8")
        # MJCF names meshes and textures by file=, relative to the scene's own folder.
        if ' file="' in text and out.resolve().parent != scene.resolve().parent:
            sys.stderr.write(f"{out} has file names relative to {scene.parent}; move it there\n")
    if as_json:
        print_json({"component": name, "tip_mass": mass, "file": out, "mjcf": text})
    elif out is None:
        sys.stdout.write(text)


def _mass_note(name: str, facts: dict[str, Any], mass: list[list[float]] | None, tip: str) -> str:
    """Return a text on the mass (6, 6), kg to kg·m^2, that moves with the tip; None: unknown."""
    if mass is None:
        return f"{name} has no known mass, so {tip!r} has none of it; give its materials a density"
    total = facts["vibration"]["mass"]
    at_tip = sum(mass[k][k] for k in range(3)) / 3
    return (
        f"{at_tip:.4g} kg of the part's {total:.4g} kg move with {tip!r}. Add the mass that moves "
        "with no tip to the base's body"
    )


def _tip_interface(
    name: str, facts: dict[str, Any], interface: str | None = None
) -> tuple[dict[str, Any], list[list[float]] | None]:
    """Return the facts of the interface at the tip, which moves, and the mass condensed to it.

    The mass has shape (6, 6), kg to kg·m^2; None if it is unknown. A single interface has no name.
    At least one moves, since a bundle without any is refused.

    Raises BadParameter if the interface does not move, or several do and none is named.
    """
    interfaces = facts.get("interfaces") or {"": facts.get("interface") or {}}
    moving = [key for key, body in interfaces.items() if not body.get("held")]
    if interface is not None and moving == [""]:
        raise typer.BadParameter(
            f"{name} has a single interface, which has no name; leave --interface {interface} out"
        )
    at = moving[0] if interface is None and len(moving) == 1 else interface
    if at is None or at not in moving:
        subject = f"{name} has no interface {at!r} that moves; it" if interface else name
        raise typer.BadParameter(
            f"{subject} moves at {', '.join(moving)}; name the interface of the tip, for example: "
            f"--interface {moving[0]}"
        )
    first = FREEDOMS * list(interfaces).index(at)
    freedoms = slice(first, first + FREEDOMS)
    matrix = (facts.get("vibration") or {}).get("condensed_mass") or []
    return interfaces[at], [row[freedoms] for row in matrix[freedoms]] or None


def stiffness(
    name: Name,
    force: _Force = ZERO,
    moment: _Moment = ZERO,
    further: FurtherInput = None,
    between: Annotated[
        tuple[float, float] | None,
        typer.Option(
            metavar="LOW HIGH", help="fit the measured rows between these two loads instead"
        ),
    ] = None,
    axis: Annotated[str | None, typer.Option(help="with --between: load, such as fz")] = None,
    of: Annotated[str | None, typer.Option(help="with --between: output, such as uz")] = None,
    number: Annotated[
        int | None,
        typer.Option("--import", min=1, help="with --between: use the rows of this import only"),
    ] = None,
    out: Annotated[
        Path | None, typer.Option(help="write JSON to this file", callback=in_folder)
    ] = None,
    as_json: AsJson = False,
    server: Server = DEFAULT_SERVER,
    data: Data = None,
) -> None:
    """Show a component's 6x6 stiffness about a load, its mass, and its error of linearity.

    With --between: the slope of one load over one output in its measured rows.
    """
    if between is None:
        refuse_alone("--between LOW HIGH", {"--axis": axis, "--of": of, "--import": number})
    shown: list[Table | str]
    with connected(server, data) as client:
        if between is not None:
            body = client.stiffness(name, between, axis, of, number)
            shown = [*stiffness_lines(body)]
        else:
            facts = client.component(name)
            wrench = (*force, *moment)
            part = LinearPart.of(client.download(name), wrench, further_inputs(further))
            body = part.to_dict(_tip_interface(name, facts)[1])
            freedoms = part.freedoms
            shown = [
                matrix_table(
                    "stiffness, N/m to N·m/rad", body["loads"], freedoms, body["stiffness"]
                ),
                matrix_table("condensed mass, kg to kg·m^2", freedoms, freedoms, body["mass"]),
                part.error,
            ]
    if out is not None:
        out.write_text(json.dumps(body, indent=2) + "\n", encoding="utf-8")
    show(body, as_json, lambda: shown)

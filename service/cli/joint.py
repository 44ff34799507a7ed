"""``wrenchbook joint``: a MuJoCo scene with the joints of a part."""

from __future__ import annotations

import sys
from pathlib import Path
from typing import Annotated

import typer

from wrenchbook.service.cli.connect import (
    DEFAULT_SERVER,
    AsJson,
    Data,
    Name,
    Server,
    connected,
    print_json,
)


def joint(
    name: Name,
    scene: Annotated[Path, typer.Argument(help="the MJCF file", exists=True, dir_okay=False)],
    base: Annotated[str, typer.Option(help="body on the support's side")] = "base",
    tip: Annotated[str, typer.Option(help="body on the interface's side, its child")] = "tip",
    site: Annotated[
        str | None,
        typer.Option(help="site of the tip: interface point and frame; else the body's own"),
    ] = None,
    massless: Annotated[
        bool, typer.Option("--massless", help="do not add the part's own mass to the tip")
    ] = False,
    out: Annotated[Path | None, typer.Option(help="write to this file, not to stdout")] = None,
    as_json: AsJson = False,
    server: Server = DEFAULT_SERVER,
    data: Data = None,
) -> None:
    """Write a MuJoCo scene in which a component can bend between two bodies, for MujocoJoint."""
    from wrenchbook.service.client.joint.mujoco_model import scene_with_joint

    with connected(server, data) as client:
        facts = client.component(name)
    vibration = facts.get("vibration") or {}
    mass = None if massless else vibration.get("condensed_mass")
    locked = (facts.get("interface") or {}).get("locked", ())
    text = scene_with_joint(scene, base, tip, locked=locked, site=site, mass=mass)
    if mass is None and not massless:
        sys.stderr.write(f"{name} has no known mass: give its materials a density\n")
    elif mass is not None:
        whole, own = vibration["mass"], sum(mass[k][k] for k in range(3)) / 3
        sys.stderr.write(
            f"{own:.4g} kg of the part's {whole:.4g} kg move with the tip; give the base the rest\n"
        )
    if out is not None:
        out.write_text(text, encoding="utf-8")
    if as_json:
        print_json({"component": name, "tip_mass": mass, "file": out, "mjcf": text})
    elif out is None:
        sys.stdout.write(text)

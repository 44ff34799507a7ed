"""Ten kinds of STEP parts with holes and fillets, of random dimensions, as engineers mesh them.

Each is held at small holes or at a face and loaded at a bore or at a face, by a rigid or a
distributed coupling, with cells of 0.7 to 1.3 times its wall.
"""

import numpy as np

from tests.benchmarks.kinds_of_parts import BUNDLE, STEEL
from tests.fea.geometry import drawing, require_gmsh
from wrenchbook.fea.bundle.read import read_bundle


def between(chance, low, high):
    return float(np.round(chance.uniform(low, high), 2))


def fillet(occ, solid, radius, low, high):
    """Round the edges whose box lies within the corners `low` and `high`."""
    occ.synchronize()
    model = require_gmsh().model
    edges = []
    for _, tag in model.getEntities(1):
        box = np.array(model.getBoundingBox(1, tag))
        if (box[:3] > np.array(low) - 0.01).all() and (box[3:] < np.array(high) + 0.01).all():
            edges.append(tag)
    assert edges, "no edge to round"
    return occ.fillet([solid[1]], edges, [radius])[0]


def drill(occ, solid, *cylinders):
    """Cut cylinders (x, y, z, direction, radius) out of a solid."""
    tools = [(3, occ.addCylinder(x, y, z, *along, r)) for x, y, z, along, r in cylinders]
    return occ.cut([solid], tools)[0][0]


def angle(occ, c):
    """An L-bracket: four holes in the foot, a bore in the wall, a fillet inside."""
    t, w, long, h = between(c, 5, 9), between(c, 35, 50), between(c, 60, 90), between(c, 50, 70)
    r, bore = between(c, 2.5, 4.5), between(c, 5, 8)
    a, b = occ.addBox(0, 0, 0, long, w, t), occ.addBox(0, 0, 0, t, w, h)
    (solid,), _ = occ.fuse([(3, a)], [(3, b)])
    solid = fillet(occ, solid, between(c, 4, 8), (t, 0, t), (t, w, t))
    holes = [(x, y, -1, (0, 0, t + 2), r) for x in (long - 10, long - 35) for y in (9, w - 9)]
    drill(occ, solid, *holes, (-1, w / 2, h - 15, (t + 2, 0, 0), bore))
    return t, f"radius = {r / 1e3:.5f}", f"radius = {bore / 1e3:.5f}"


def flange(occ, c):
    """A disc with a pipe and a fillet between the two, and holes on a circle."""
    t, r, outer = between(c, 6, 10), between(c, 3, 4.5), between(c, 15, 22)
    wall, high, n = between(c, 4, 6), between(c, 35, 60), int(c.integers(4, 7))
    disc = occ.addCylinder(0, 0, 0, 0, 0, t, outer + 24)
    pipe = occ.addCylinder(0, 0, t, 0, 0, high - t, outer)
    (solid,), _ = occ.fuse([(3, disc)], [(3, pipe)])
    solid = fillet(occ, solid, between(c, 2, 5), (-outer, -outer, t), (outer, outer, t))
    turns = 2 * np.pi * np.arange(n) / n
    holes = [
        ((outer + 15) * np.cos(a), (outer + 15) * np.sin(a), -1, (0, 0, t + 2), r) for a in turns
    ]
    drill(occ, solid, *holes, (0, 0, -1, (0, 0, high + 2), outer - wall))
    return t, f"radius = {r / 1e3:.5f}", f'plane = "z"\nat = {high / 1e3:.5f}'


def plate(occ, c):
    """A plate with round corners, held at four holes, loaded at a bore."""
    t, long, w = between(c, 5, 9), between(c, 80, 120), between(c, 60, 90)
    r, bore = between(c, 2.5, 4.5), between(c, 8, 14)
    solid = (3, occ.addBox(0, 0, 0, long, w, t))
    solid = fillet(occ, solid, 7, (0, 0, 0), (0, 0, t))
    solid = fillet(occ, solid, 7, (long, w, 0), (long, w, t))
    holes = [(x, y, -1, (0, 0, t + 2), r) for x in (10, long - 10) for y in (10, w - 10)]
    place = (long * c.uniform(0.4, 0.6), w * c.uniform(0.4, 0.6), -1)
    drill(occ, solid, *holes, (*place, (0, 0, t + 2), bore))
    return t, f"radius = {r / 1e3:.5f}", f"radius = {bore / 1e3:.5f}"


def lug(occ, c):
    """An eye on a foot with two holes."""
    t, f, w = between(c, 9, 14), between(c, 6, 10), between(c, 28, 40)
    high, r, bore = between(c, 35, 55), between(c, 2.6, 4.2), between(c, 5, 9)
    foot = occ.addBox(-40, -w / 2, 0, 80, w, f)
    neck = occ.addBox(-t / 2, -w / 2, 0, t, w, high)
    head = occ.addCylinder(-t / 2, 0, high, t, 0, 0, w / 2)
    (solid,), _ = occ.fuse([(3, foot)], [(3, neck), (3, head)])
    solid = fillet(occ, solid, between(c, 3, 6), (t / 2, -w / 2, f), (t / 2, w / 2, f))
    holes = [(x, 0, -1, (0, 0, f + 2), r) for x in (-28, 28)]
    drill(occ, solid, *holes, (-t, 0, high, (2 * t, 0, 0), bore))
    return t, f"radius = {r / 1e3:.5f}", f"radius = {bore / 1e3:.5f}"


def channel(occ, c):
    """A U-profile with inner fillets, held at holes of its web, loaded at bores of its flanges."""
    t, long, w, h = between(c, 4, 7), between(c, 70, 100), between(c, 36, 50), between(c, 25, 40)
    r, bore = between(c, 2.2, 4), between(c, 4.2, 7)
    block, inside = occ.addBox(0, 0, 0, long, w, h), occ.addBox(-1, t, t, long + 2, w - 2 * t, h)
    (solid,), _ = occ.cut([(3, block)], [(3, inside)])
    inner = between(c, 2, 4)
    solid = fillet(occ, solid, inner, (0, t, t), (long, t, t))
    solid = fillet(occ, solid, inner, (0, w - t, t), (long, w - t, t))
    holes = [(x, w / 2, -1, (0, 0, t + 2), r) for x in (12, 40)]
    drill(occ, solid, *holes, (long - 15, -1, h - 10, (0, w + 2, 0), bore))
    return t, f"radius = {r / 1e3:.5f}", f"radius = {bore / 1e3:.5f}"


def lever(occ, c):
    """A bar between two bosses."""
    t, long, w = between(c, 6, 10), between(c, 70, 110), between(c, 12, 18)
    first, second = between(c, 4, 6), between(c, 6.5, 9)
    bosses = [
        (3, occ.addCylinder(0, 0, 0, 0, 0, 1.6 * t, 13)),
        (3, occ.addCylinder(long, 0, 0, 0, 0, 1.6 * t, 16)),
    ]
    (solid,), _ = occ.fuse([(3, occ.addBox(0, -w / 2, 0, long, w, t))], bosses)
    solid = drill(occ, solid, (long / 2, 0, -1, (0, 0, 2 * t), between(c, 2, 3.5)))
    drill(occ, solid, (0, 0, -1, (0, 0, 2 * t), first), (long, 0, -1, (0, 0, 2 * t), second))
    return t, f"radius = {first / 1e3:.5f}", f"radius = {second / 1e3:.5f}"


def shaft(occ, c):
    """A stepped shaft with a round shoulder and a cross hole."""
    big, small = between(c, 12, 16), between(c, 7, 10)
    a, b = between(c, 25, 40), between(c, 40, 60)
    parts = occ.addCylinder(0, 0, 0, a, 0, 0, big), occ.addCylinder(a, 0, 0, b, 0, 0, small)
    (solid,), _ = occ.fuse([(3, parts[0])], [(3, parts[1])])
    solid = fillet(occ, solid, between(c, 1, 2), (a, -small, -small), (a, small, small))
    drill(occ, solid, (a + b * c.uniform(0.4, 0.7), 0, -20, (0, 0, 40), between(c, 2, 3)))
    return small, 'plane = "x"\nat = 0.0', f'plane = "x"\nat = {(a + b) / 1e3:.5f}'


def tee(occ, c):
    """A web with a bore on a foot with four holes, fillets at both sides."""
    t, long, w, h = between(c, 6, 9), between(c, 60, 80), between(c, 30, 45), between(c, 35, 55)
    r, bore = between(c, 2.5, 4), between(c, 5, 8)
    foot, web = occ.addBox(0, 0, 0, long, w, t), occ.addBox((long - t) / 2, 0, t, t, w, h)
    (solid,), _ = occ.fuse([(3, foot)], [(3, web)])
    solid = fillet(occ, solid, between(c, 2, 5), ((long - t) / 2, 0, t), ((long + t) / 2, w, t))
    holes = [(x, y, -1, (0, 0, t + 2), r) for x in (8, long - 8) for y in (8, w - 8)]
    drill(occ, solid, *holes, (0, w / 2, t + h - 14, (long, 0, 0), bore))
    return t, f"radius = {r / 1e3:.5f}", f"radius = {bore / 1e3:.5f}"


def gusset(occ, c):
    """An angle with a rib, two holes in the foot and a face that is loaded."""
    t, w, long, h = between(c, 5, 8), between(c, 40, 55), between(c, 55, 80), between(c, 50, 70)
    r = between(c, 2.5, 4.5)
    rib = occ.addBox(0, w / 2 - t / 2, 0, long * c.uniform(0.35, 0.5), t, h * c.uniform(0.4, 0.6))
    foot, wall = occ.addBox(0, 0, 0, long, w, t), occ.addBox(0, 0, 0, t, w, h)
    (solid,), _ = occ.fuse([(3, foot)], [(3, wall), (3, rib)])
    solid = fillet(occ, solid, between(c, 4, 8), (long, 0, 0), (long, 0, t))
    solid = fillet(occ, solid, 5, (long, w, 0), (long, w, t))
    holes = [(long - 12, y, -1, (0, 0, t + 2), r) for y in (10, w - 10)]
    drill(occ, solid, *holes, (-1, w / 2, h - 10, (t + 2, 0, 0), between(c, 2, 4)))
    return t, f"radius = {r / 1e3:.5f}", f'plane = "z"\nat = {h / 1e3:.5f}'


def cover(occ, c):
    """A box open below with round inner edges, a bore in its top and holes in its rim's ears."""
    t, long, w, h = between(c, 4, 7), between(c, 45, 65), between(c, 40, 55), between(c, 25, 35)
    r, bore = between(c, 2.2, 3.5), between(c, 6, 10)
    block = occ.addBox(0, 0, 0, long, w, h)
    ears = occ.addBox(-16, 0, 0, long + 32, w, t)
    inside = occ.addBox(t, t, -1, long - 2 * t, w - 2 * t, h - t + 1)
    (solid,), _ = occ.fuse([(3, block)], [(3, ears)])
    (solid,), _ = occ.cut([solid], [(3, inside)])
    solid = fillet(occ, solid, between(c, 2, 4), (t, t, h - t), (long - t, w - t, h - t))
    holes = [(x, y, -1, (0, 0, t + 2), r) for x in (-8, long + 8) for y in (9, w - 9)]
    drill(occ, solid, *holes, (long / 2, w / 2, 0, (0, 0, h + 2), bore))
    return t, f"radius = {r / 1e3:.5f}", f"radius = {bore / 1e3:.5f}"


DRAW = (angle, flange, plate, lug, channel, lever, shaft, tee, gusset, cover)


def bundle_of(draw, seed, folder):
    """A part of one kind: the same for the same seed."""
    chance = np.random.default_rng([seed, DRAW.index(draw)])
    with drawing(folder / "part.step") as occ:
        wall, base, tip = draw(occ, chance)
    mesh = f'file = "part.step"\nsize = {1e-3 * wall * chance.uniform(0.7, 1.3):.5f}'
    mesh += f"\n[mesh.groups.base]\n{base}\n[mesh.groups.tip]\n{tip}"
    text = BUNDLE.format(mesh=mesh, material=STEEL, force=1000, moment=50)
    text = text.replace("nonlinear = true", "nonlinear = false")
    if chance.random() < 0.5:
        text = text.replace('"rigid"', '"distributed"')
    (folder / "component.toml").write_text(text)
    return read_bundle(folder)

"""Rooms to walk through: the test site of the paper's Figure 7, similar rooms from other seeds, and a blank wall."""

from collections.abc import Callable
from functools import lru_cache
from itertools import pairwise

import numpy as np

from rholoc.simulation import textures
from rholoc.simulation.construction import (
    FLOOR_PX_PER_M,
    Builder,
    Decor,
    add_bookshelf,
    add_table,
    lamp_diffuser,
    radiator_ribs,
    window_view,
)
from rholoc.simulation.scene import Box, Scene, Source
from rholoc.simulation.textures import Texture, color

ROOM_SIZE_M = (6.0, 5.0, 2.7)
START_M = (1.45, 0.95, 1.4)  # from the room's corner on the floor: the origin of the map frame

_Framed = Callable[[int, float, float, float, float], list[Decor]]


@lru_cache(maxsize=2)
def make_test_site(seed: int = 0) -> Scene:
    """The test site: an L-shaped part of a 6 × 5 × 2.7 m room, with furniture, posters, a window and two lamps.

    Its map frame has its origin at the start of the first walk, ``START_M`` from the room's corner, x and y along its
    walls. Other seeds give other rooms: the same plan with other furniture sizes, posters and colours. The last two are
    cached, because making and lighting a room takes seconds.
    """
    build = Builder(seed)
    rng = build.rng("plan")

    def jitter(scale: float) -> float:
        return float(rng.uniform(-scale, scale))

    hue = rng.uniform(0.05, 0.16)
    ground = textures.plaster(color(hue, 0.10, 0.86))
    accent = textures.plaster(color(hue + 0.45 + jitter(0.1), 0.28, 0.72))
    oak, walnut, pale = (
        color(0.085, 0.5, 0.68 + jitter(0.08)),
        color(0.06, 0.55, 0.42 + jitter(0.05)),
        color(0.1, 0.18, 0.85),
    )
    length, breadth, height = ROOM_SIZE_M

    def framed(count: int, left: float, right: float, bottom: float, top: float) -> list[Decor]:
        """Posters and paintings side by side between ``left`` and ``right``."""
        slots = np.linspace(left, right, count + 1)
        items = []
        for a, b in pairwise(slots.tolist()):
            width = (b - a) * rng.uniform(0.6, 0.85)
            tall = min(top - bottom, width * rng.uniform(0.9, 1.5))
            low = bottom + rng.uniform(0, max(top - bottom - tall, 1e-3))
            texture = textures.poster if rng.uniform() < 0.65 else textures.painting
            items.append(Decor(a + 0.5 * (b - a - width), low, width, tall, texture))
        return items

    # Decor is placed along each wall from its left edge as seen from inside the room.
    window = Decor(1.55 + jitter(0.1), 0.95, 1.5, 1.35, window_view, Source.WINDOW)
    back = [window, *framed(3, 3.35, 5.3, 1.15, 2.2), Decor(0.75, 1.2, 0.5, 0.7, textures.painting)]
    left = [*framed(2, 0.5, 2.0, 1.2, 2.2), *framed(1, 4.15, 4.8, 1.1, 2.1)]
    front = [
        Decor(4.55, 0.0, 0.85, 2.05, textures.panel(pale, 1, 2)),
        *framed(1, 3.85, 4.45, 1.2, 2.1),
        Decor(5.47, 1.1, 0.08, 0.08, textures.whiteboard),
    ]
    right = [
        Decor(1.35, 0.0, 0.85, 2.05, textures.panel(oak, 1, 2)),
        *framed(2, 0.1, 1.25, 1.2, 2.2),
        *framed(1, 2.3, 2.75, 1.0, 2.0),
    ]
    lamps = [Decor(x, y, 0.6, 0.6, lamp_diffuser, Source.LAMP) for x, y in ((4.1, 1.0), (4.1, 3.4), (1.3, 3.3))]
    room_paints = {
        "y+": build.wall("back", length, height, ground, back),
        "x-": build.wall("left", breadth, height, accent, left),
        "y-": build.wall("front", length, height, ground, front),
        "x+": build.wall("right", breadth, height, ground, right),
        "z-": build.wall(
            "floor",
            length,
            breadth,
            textures.planks(oak),
            [Decor(3.1, 1.2, 1.9, 1.35, textures.fabric_pattern)],
            FLOOR_PX_PER_M,
        ),
        "z+": build.wall("ceiling", length, breadth, textures.plaster((238, 240, 240)), lamps, FLOOR_PX_PER_M),
    }
    room = Box(0.5 * np.array(ROOM_SIZE_M), np.array(ROOM_SIZE_M), 0.0, room_paints)

    _block(build, framed, ground)
    _furnish(build, rng, oak, walnut, pale)
    return Scene(room, tuple(build.boxes)).moved(-np.array(START_M))


def make_blank_wall() -> Scene:
    """A room of the test site's size, white and without any features but a lamp, in the same map frame."""
    build = Builder(0)
    white = textures.plaster((236, 238, 238), strength=0.15)
    sizes = {"x": ROOM_SIZE_M[1:], "y": (ROOM_SIZE_M[0], ROOM_SIZE_M[2]), "z": ROOM_SIZE_M[:2]}
    lamp = [Decor(2.7, 2.2, 0.6, 0.6, lamp_diffuser, Source.LAMP)]
    paints = {
        face: build.wall(face, *sizes[face[0]], white, lamp if face == "z+" else [], 60.0)
        for face in ("x+", "y+", "x-", "y-", "z+", "z-")
    }
    return Scene(Box(0.5 * np.array(ROOM_SIZE_M), np.array(ROOM_SIZE_M), 0.0, paints), ()).moved(-np.array(START_M))


def _block(build: Builder, framed: _Framed, ground: Texture) -> None:
    """Add the block that cuts the room to an L, painted with ``ground`` and hung with pictures by ``framed``."""
    length, _, height = ROOM_SIZE_M
    edge_x, edge_y = 3.2, 2.2
    board = Decor(0.55, 1.05, 1.35, 0.95, textures.whiteboard)
    paints = {
        "x-": build.wall("block/x-", edge_y, height, ground, framed(2, 0.15, 2.05, 1.15, 2.15)),
        "y+": build.wall("block/y+", length - edge_x, height, ground, [board, *framed(1, 2.05, 2.7, 1.1, 2.2)]),
    }
    centre = np.array([0.5 * (edge_x + length), 0.5 * edge_y, 0.5 * height])
    build.boxes.append(Box(centre, np.array([length - edge_x, edge_y, height]), 0.0, paints))


def _furnish(
    build: Builder,
    rng: np.random.Generator,
    oak: tuple[int, int, int],
    walnut: tuple[int, int, int],
    pale: tuple[int, int, int],
) -> None:
    """Add furniture along the walls; the way between them stays clear. Colours are BGR."""

    def jitter(scale: float) -> float:
        return float(rng.uniform(-scale, scale))

    build.piece = "left shelf"
    add_bookshelf(build, "left shelf", (0.0, 1.05), (0.28, 1.05), walnut, levels=4)

    build.piece = "sofa"
    upholstery = textures.cushions(textures.random_color(rng, (0.35, 0.7), (0.35, 0.7)))
    y = 2.55 + jitter(0.1)
    build.add("sofa back", (0.02, y, 0.0), (0.22, 1.7, 0.85), upholstery, hidden="z-,x-")
    build.add("sofa seat", (0.24, y, 0.0), (0.58, 1.7, 0.42), upholstery, hidden="z-,x-")
    build.add("cushion", (0.26, y + 0.2, 0.42), (0.14, 0.42, 0.36), textures.fabric_pattern, hidden="z-,x-")
    build.add("cushion 2", (0.26, y + 1.0, 0.42), (0.14, 0.45, 0.38), textures.fabric_pattern, hidden="z-,x-")

    build.piece = "cupboard"
    tall = 1.75 + jitter(0.2)
    build.add(
        "cupboard",
        (2.2, 0.0, 0.0),
        (0.9, 0.48, tall),
        textures.wood(oak, True),
        hidden="z-,y-",
        front={"y+": textures.panel(oak, 2, 1)},
    )
    build.add("box on cupboard", (2.35, 0.06, tall), (0.5, 0.36, 0.3), textures.cardboard)
    build.piece = "boxes"
    build.add("box by door", (0.18, 0.08, 0.0), (0.38, 0.36, 0.34), textures.cardboard, yaw=0.2)
    build.add("box on box", (0.22, 0.1, 0.34), (0.3, 0.28, 0.26), textures.cardboard, yaw=-0.3)

    build.piece = "drawers"
    build.add(
        "drawers",
        (2.76, 0.75, 0.0),
        (0.44, 1.1, 0.8),
        textures.wood(walnut),
        hidden="z-,x+",
        front={"x-": textures.panel(walnut, 2, 3)},
    )
    build.add("crate", (2.83, 0.85, 0.8), (0.3, 0.34, 0.24), textures.cardboard, yaw=0.15)
    build.add("books on drawers", (2.86, 1.4, 0.8), (0.24, 0.36, 0.26), textures.books)

    build.piece = ""
    build.add(
        "radiator",
        (1.6, 4.9, 0.12),
        (1.4, 0.08, 0.6),
        textures.plaster((225, 228, 228)),
        hidden="y+",
        front={"y-": radiator_ribs},
    )
    build.piece = "side table"
    add_table(build, "side table", (0.95, 4.42), (0.5, 0.5), 0.55, pale)
    build.add("globe box", (1.05, 4.52, 0.55), (0.3, 0.3, 0.34), textures.poster, yaw=0.4)

    build.piece = "desk"
    add_table(build, "desk", (3.95, 2.24), (1.4, 0.62), 0.74, oak)
    build.add(
        "monitor",
        (4.25, 2.34, 0.86),
        (0.58, 0.05, 0.36),
        textures.plaster((40, 40, 42)),
        hidden="",
        front={"y+": textures.screen},
    )
    build.add("monitor foot", (4.46, 2.32, 0.74), (0.16, 0.14, 0.12), textures.plaster((50, 50, 52)))
    build.add("paper tray", (5.0, 2.34, 0.74), (0.28, 0.34, 0.14), textures.books, yaw=0.1)
    build.piece = "chair"
    build.add(
        "chair seat",
        (4.45, 2.7, 0.42),
        (0.42, 0.4, 0.06),
        textures.fabric(textures.random_color(rng)),
        yaw=0.25,
        hidden="",
    )
    build.add("chair post", (4.63, 2.87, 0.0), (0.07, 0.07, 0.42), textures.plaster((60, 60, 64)))

    build.piece = "back shelf"
    add_bookshelf(build, "back shelf", (3.45, 4.72), (1.5, 0.28), oak, levels=2)
    build.add("plant pot", (3.6, 4.76, 1.01), (0.2, 0.2, 0.2), textures.fabric_pattern, yaw=0.3)
    build.add("box on shelf", (4.2, 4.75, 1.01), (0.45, 0.22, 0.2), textures.cardboard)

    build.piece = "locker"
    build.add("locker", (5.55, 4.45, 0.0), (0.45, 0.5, 1.5 + jitter(0.2)), textures.panel(pale, 1, 2), hidden="z-,x+")
    build.piece = "bin"
    build.add("bin", (5.62, 2.3, 0.0), (0.28, 0.28, 0.4), textures.poster, yaw=0.2)

"""Parts of rooms: painted walls with their decor, boxes, and furniture made of boxes."""

import zlib
from dataclasses import dataclass, field

import cv2
import numpy as np

from rholoc.geometry import BoolArray, ByteArray
from rholoc.simulation import textures
from rholoc.simulation.scene import Box, Paint, Source
from rholoc.simulation.textures import Texture

FRAME_GRAY = 218  # the frames of windows and lamps, which do not shine themselves
WALL_PX_PER_M = 360.0
FLOOR_PX_PER_M = 300.0
FURNITURE_PX_PER_M = 400.0


@dataclass(frozen=True, eq=False)
class Decor:
    """Something painted on a wall: its left edge and its bottom above the floor, its size, all metres."""

    left: float
    bottom: float
    width: float
    height: float
    texture: Texture
    source: Source | None = None


@dataclass
class Builder:
    """Collects boxes; every face gets its own random numbers from the room's seed and its own name.

    ``piece`` names the piece of furniture that the boxes added next are parts of.
    """

    seed: int
    boxes: list[Box] = field(default_factory=list)
    furniture_px_per_m: float = FURNITURE_PX_PER_M
    piece: str = ""

    def rng(self, name: str) -> np.random.Generator:
        """Random numbers of the face ``name``, always the same for a seed."""
        return np.random.default_rng([self.seed, zlib.crc32(name.encode())])

    def paint(self, name: str, texture: Texture, width_m: float, height_m: float, px_per_m: float) -> Paint:
        """Paint of a face of this size, by its texture; at least 8 px a side."""
        height, width = max(8, round(height_m * px_per_m)), max(8, round(width_m * px_per_m))
        return Paint(texture(self.rng(name), height, width))

    def wall(
        self,
        name: str,
        width_m: float,
        height_m: float,
        ground: Texture,
        decor: list[Decor],
        px_per_m: float = WALL_PX_PER_M,
    ) -> Paint:
        """A wall's paint: the texture ``ground`` with decor on it; it glows where decor is a source of light."""
        albedo = self.paint(name, ground, width_m, height_m, px_per_m).albedo
        glow: BoolArray | None = None
        source: Source | None = None
        for i, item in enumerate(decor):
            x0, x1 = round(item.left * px_per_m), round((item.left + item.width) * px_per_m)
            y0, y1 = (round((height_m - item.bottom - h) * px_per_m) for h in (item.height, 0.0))
            image = item.texture(self.rng(f"{name}/{i}"), y1 - y0, x1 - x0)
            albedo[y0:y1, x0:x1] = image
            if item.source is not None:
                glow = np.zeros(albedo.shape[:2], bool) if glow is None else glow
                glow[y0:y1, x0:x1] = (image != FRAME_GRAY).any(axis=2)
                source = item.source
        return Paint(albedo, glow, source)

    def add(
        self,
        name: str,
        low: tuple[float, float, float],
        size: tuple[float, float, float],
        texture: Texture,
        *,
        yaw: float = 0.0,
        hidden: str = "z-",
        front: dict[str, Texture] | None = None,
        px_per_m: float | None = None,
    ) -> None:
        """Add a box by its low corner and size [m], turned by ``yaw`` [rad] about its centre.

        ``hidden`` faces (comma-separated) are not painted; ``front`` has textures of faces that differ from
        ``texture``.
        """
        extent = {"x": (size[1], size[2]), "y": (size[0], size[2]), "z": (size[0], size[1])}
        paints = {}
        for face in ("x+", "y+", "x-", "y-", "z+", "z-"):
            if face not in hidden.split(","):
                chosen = (front or {}).get(face, texture)
                paints[face] = self.paint(
                    f"{name}/{face}", chosen, *extent[face[0]], px_per_m or self.furniture_px_per_m
                )
        centre = np.array(low) + 0.5 * np.array(size)
        self.boxes.append(Box(centre, np.array(size), yaw, paints, self.piece))


def add_bookshelf(
    build: Builder,
    name: str,
    corner: tuple[float, float],
    size: tuple[float, float],
    tone: tuple[int, int, int],
    levels: int,
) -> None:
    """Add ``levels`` + 1 boards of colour ``tone`` (BGR), 0.49 m from one to the next, with books between, from the
    floor up.

    ``corner`` and ``size`` are x and y [m]; the shelf runs along the longer side, and the other should be 0.28 m.
    """
    board, gap = 0.03, 0.46
    along_x = size[0] > size[1]
    for level in range(levels + 1):
        build.add(
            f"{name} board {level}", (*corner, level * (board + gap)), (*size, board), textures.wood(tone), hidden=""
        )
    for level in range(levels):
        low, z = 0.02, level * (board + gap) + board
        rng = build.rng(f"{name} row {level}")
        reach = (size[0] if along_x else size[1]) - 0.02
        while reach - low > 0.12:
            run = min(float(rng.uniform(0.2, 0.55)), reach - low)
            tall, deep = float(rng.uniform(0.24, 0.36)), 0.28 * float(rng.uniform(0.55, 0.85))
            if along_x:
                at, extent = (corner[0] + low, corner[1] + 0.28 - deep, z), (run - 0.03, deep, tall)
            else:
                at, extent = (corner[0], corner[1] + low, z), (deep, run - 0.03, tall)
            build.add(f"{name} books {level} {low:.3f}", at, extent, textures.books)
            low += run


def add_table(
    build: Builder,
    name: str,
    corner: tuple[float, float],
    size: tuple[float, float],
    height: float,
    tone: tuple[int, int, int],
) -> None:
    """Add a board of colour ``tone`` (BGR) on four legs, its top at ``height``; ``corner`` and ``size``: x, y [m]."""
    build.add(f"{name} top", (*corner, height - 0.04), (*size, 0.04), textures.wood(tone), hidden="")
    for i, (x, y) in enumerate(((0, 0), (1, 0), (0, 1), (1, 1))):
        at = (corner[0] + 0.03 + x * (size[0] - 0.11), corner[1] + 0.03 + y * (size[1] - 0.11), 0.0)
        build.add(f"{name} leg {i}", at, (0.05, 0.05, height - 0.04), textures.wood(tone, True), hidden="z-,z+")


def window_view(rng: np.random.Generator, height: int, width: int) -> ByteArray:
    """Paint (H, W, 3) BGR of an outdoor view behind a cross and frame of ``FRAME_GRAY``."""
    image = textures.outdoors(rng, height, width)
    bar = max(6, width // 22)
    for x in (0, (width - bar) // 2, width - bar):
        image[:, x : x + bar] = FRAME_GRAY
    for y in (0, int(0.3 * height), height - bar):
        image[y : y + bar] = FRAME_GRAY
    return image


def lamp_diffuser(rng: np.random.Generator, height: int, width: int) -> ByteArray:
    """Paint (H, W, 3) BGR of a white lamp in a frame of ``FRAME_GRAY``."""
    image = np.full((height, width, 3), 250, np.uint8)
    cv2.rectangle(image, (0, 0), (width - 1, height - 1), (FRAME_GRAY,) * 3, max(2, width // 20))
    return image


def radiator_ribs(rng: np.random.Generator, height: int, width: int) -> ByteArray:
    """Paint (H, W, 3) BGR of white vertical ribs, one in 22 px."""
    ribs = 0.16 * np.sin(np.arange(width, dtype=np.float32) * (2 * np.pi / 22))[None, :]
    return textures.shaded((222, 224, 224), ribs + 0.02 * textures.noise(rng, height, width, 40, 40))

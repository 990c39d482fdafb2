"""A building of two storeys to walk through: white corridors with look-alike doors, fourteen furnished rooms, stairs.

Half of its contents repeat: every door, desk, chair and lamp is the same make, and each kind of room is on both
floors. The rooms differ in what a person would go by: the numbers at the doors, what lies on the desks and
hangs on the walls.
"""

from dataclasses import dataclass, field

import cv2
import numpy as np

from rholoc.geometry import ByteArray, FloatArray
from rholoc.simulation import textures
from rholoc.simulation.construction import FRAME_GRAY, Builder, add_bookshelf, lamp_diffuser, radiator_ribs, window_view
from rholoc.simulation.scene import Box, Building, Paint, Portal, Scene, Source
from rholoc.simulation.textures import Texture, color

STOREY_M = 3.0
ROOM_HEIGHT_M = 2.7
ROOM_DEPTH_M = 4.4
CORRIDOR_WIDTH_M = 1.8
WALL_M = 0.12
DOOR_WIDTH_M, DOOR_HEIGHT_M = 0.9, 2.05
STAIRS_WIDTH_M = 2.7
FLIGHT_WIDTH_M = 1.3
STEPS = 9  # of each flight; the last is the landing or the floor
STEP_DEPTH_M = 0.3
STAIRS_ENTRY_M = 0.8
STOREYS = 2
ROOMS_SOUTH, ROOMS_NORTH = 4, 3

_FURNITURE_PX_PER_M = 230.0
_PICTURE_PX_PER_M = 300.0
_FLOOR_PX_PER_M = 140.0
_BARE_PX_PER_M = 60.0
_THIN_M = 0.02
_SKIRTING_M = 0.08
_Triple = tuple[float, float, float]
_WHITE = (236, 238, 238)
_FRAME = (96, 98, 100)  # of doors
_NOTES, _SOCKETS, _BAGS = 5, 3, 3  # in each room
_TRIES = 12
_APART_M = 0.03
_KINDS = ("office", "meeting", "workshop", "storage", "kitchen", "lounge", "bedroom")


@dataclass(frozen=True)
class RoomPlan:
    """Where a room lies.

    Attributes:
        name: its number at the door.
        storey: 0 or 1.
        corner: (x, y) metres, building frame: its left corner at the door's wall, as seen from the corridor.
        along: +1 where the room lies north of the corridor, −1 where it lies south and is turned by 180°.
        width: along the corridor, metres.
        door: where the door's middle is along the width, metres.
    """

    name: str
    storey: int
    corner: tuple[float, float]
    along: int
    width: float
    door: float

    def place(self, x: float, y: float, z: float = 0.0) -> FloatArray:
        """A place (3,) in the building's frame: ``x`` along the door's wall, ``y`` into the room, ``z`` above it."""
        return np.array([self.corner[0] + self.along * x, self.corner[1] + self.along * y, self.storey * STOREY_M + z])


@dataclass(frozen=True)
class Plan:
    """Where everything is, metres, in the building's frame: its south-western corner on the ground floor.

    Attributes:
        length: of the corridors, along x.
        corridor_y: of their middles.
        rooms: those to be visited, storey by storey, the southern and the northern in turn, from west to east.
        stairs_x: of the stairwell's western wall.
    """

    length: float
    corridor_y: float
    rooms: tuple[RoomPlan, ...]
    stairs_x: float

    @property
    def north_y(self) -> float:
        """y [m] of the southern wall, inside, of the northern rooms and of the stairwell."""
        return self.corridor_y + 0.5 * CORRIDOR_WIDTH_M + WALL_M

    @property
    def flight_x(self) -> tuple[float, float]:
        """x [m] of the middles of both flights: up from the ground floor, and up to the upper one."""
        return self.stairs_x + 0.5 * FLIGHT_WIDTH_M, self.stairs_x + STAIRS_WIDTH_M - 0.5 * FLIGHT_WIDTH_M


def make_plan(seed: int = 0) -> Plan:
    """The plan of a seed's building: the same on both floors, but for the seed's widths and doors."""
    rng = np.random.default_rng([seed, 101])
    south = rng.uniform(4.3, 5.6, ROOMS_SOUTH)
    length = float(south.sum() + (ROOMS_SOUTH - 1) * WALL_M)
    north = rng.uniform(4.3, 5.6, ROOMS_NORTH)
    north *= (length - STAIRS_WIDTH_M - ROOMS_NORTH * WALL_M) / north.sum()
    corridor_y = ROOM_DEPTH_M + WALL_M + 0.5 * CORRIDOR_WIDTH_M
    rooms = []
    for storey in range(STOREYS):
        number = 100 * storey
        placed: list[tuple[float, RoomPlan]] = []
        for along, widths in ((-1, south), (1, north)):
            left = 0.0
            y = corridor_y + along * (0.5 * CORRIDOR_WIDTH_M + WALL_M)
            for width in widths.tolist():
                door = float(rng.uniform(0.95, 1.15))
                x = left if along == 1 else left + width
                number += 1
                plan = RoomPlan(f"{number:03d}", storey, (x, y), along, width, door)
                placed.append((x + along * door, plan))
                left += width + WALL_M
        rooms += [plan for _, plan in sorted(placed, key=lambda item: item[0])]
    return Plan(length, corridor_y, tuple(rooms), length - STAIRS_WIDTH_M)


@dataclass
class _Site:
    """Collects rooms and the openings between them."""

    rooms: list[Scene] = field(default_factory=list)
    names: list[str] = field(default_factory=list)
    portals: list[list[Portal]] = field(default_factory=list)

    def add(self, name: str, scene: Scene) -> int:
        self.rooms.append(scene)
        self.names.append(name)
        self.portals.append([])
        return len(self.rooms) - 1

    def open(self, a: int, b: int, corners: FloatArray) -> None:
        self.portals[a].append(Portal(corners, b))
        self.portals[b].append(Portal(corners, a))

    def door(self, inside: int, corridor: int, low: FloatArray, along: int, jamb: dict[str, Paint]) -> None:
        """A doorway from the corridor into a room; ``low`` is its lower western corner at the corridor's wall."""
        size = np.array([DOOR_WIDTH_M, WALL_M, DOOR_HEIGHT_M])
        centre = low + 0.5 * size * (1, along, 1)
        way = self.add(f"door of {self.names[inside]}", Scene(Box(centre, size, 0.0, jamb), ()))
        corners = low + size * np.array([[0, 0, 0], [1, 0, 0], [1, 0, 1], [0, 0, 1]])
        self.open(corridor, way, corners)
        self.open(way, inside, corners + np.array([0.0, along * WALL_M, 0.0]))


def make_building(seed: int = 0) -> Building:
    """The building of a seed, in its plan's frame. Other seeds give other widths, furniture, pictures and contents."""
    plan = make_plan(seed)
    site = _Site()
    corridors = [site.add(f"corridor {storey}", _corridor(plan, storey, seed)) for storey in range(STOREYS)]
    jamb = _jamb(seed)
    for i, room in enumerate(plan.rooms):
        kind = _KINDS[(i + 2 * room.storey) % len(_KINDS)]
        inside = site.add(f"room {room.name}", _furnished(room, kind, seed))
        edges = room.place(room.door - 0.5 * DOOR_WIDTH_M, -WALL_M), room.place(room.door + 0.5 * DOOR_WIDTH_M, -WALL_M)
        site.door(inside, corridors[room.storey], min(edges, key=lambda edge: float(edge[0])), room.along, jamb)
    stairs = site.add("stairs", _stairwell(plan, seed))
    for storey, x in enumerate(plan.flight_x):
        low = np.array([x - 0.5 * DOOR_WIDTH_M, plan.north_y - WALL_M, storey * STOREY_M])
        site.door(stairs, corridors[storey], low, 1, jamb)
    return Building(tuple(site.rooms), tuple(site.names), tuple(tuple(openings) for openings in site.portals))


# -- what recurs -----------------------------------------------------------------------------------------------------


def _builder(seed: int) -> Builder:
    return Builder(seed, furniture_px_per_m=_FURNITURE_PX_PER_M)


def _wall_paint(
    build: Builder, name: str, width: float, height: float, ground: Texture = textures.plaster(_WHITE, 0.4)
) -> Paint:
    """A bare wall with its skirting board."""
    paint = build.paint(name, ground, width, height, _BARE_PX_PER_M)
    paint.albedo[-max(2, round(_SKIRTING_M * _BARE_PX_PER_M)) :] = (120, 126, 130)
    return paint


def _shell(
    build: Builder, name: str, size: FloatArray, floor: Texture, accent: dict[str, Texture] | None = None
) -> dict[str, Paint]:
    """The walls, the floor and the ceiling of an empty room."""
    paints = {}
    for face in ("x+", "y+", "x-", "y-"):
        ground = (accent or {}).get(face, textures.plaster(_WHITE, 0.4))
        width = float(size[1] if face[0] == "x" else size[0])
        paints[face] = _wall_paint(build, f"{name}/{face}", width, float(size[2]), ground)
    paints["z-"] = build.paint(f"{name}/floor", floor, float(size[0]), float(size[1]), _FLOOR_PX_PER_M)
    ceiling = textures.plaster((240, 242, 242), 0.3)
    paints["z+"] = build.paint(f"{name}/ceiling", ceiling, float(size[0]), float(size[1]), _BARE_PX_PER_M)
    return paints


def _linoleum(rng: np.random.Generator, height: int, width: int) -> ByteArray:
    """Grey, with faint flecks and a few scuffs."""
    shade = 0.02 * textures.noise(rng, height, width, 200, 200) + 0.025 * textures.noise(rng, height, width, 2.5, 2.5)
    return textures.shaded((150, 156, 158), shade)


def _carpet(base: tuple[int, int, int]) -> Texture:
    def paint(rng: np.random.Generator, height: int, width: int) -> ByteArray:
        shade = 0.03 * textures.noise(rng, height, width, 60, 60) + 0.05 * textures.noise(rng, height, width, 1.6, 1.6)
        return textures.shaded(base, shade)

    return paint


def _door_leaf(rng: np.random.Generator, height: int, width: int) -> ByteArray:
    """A plain grey-white door with its handle, lock and hinges; every door in the building looks like this."""
    image = textures.shaded((206, 214, 216), 0.012 * textures.noise(rng, height, width, 200, 60))
    image[:, :2] = image[:, -2:] = (150, 152, 154)
    handle_y, handle_x = round(0.49 * height), round(0.91 * width)
    image[handle_y - 8 : handle_y + 26, handle_x - 5 : handle_x + 5] = (110, 112, 114)
    image[handle_y : handle_y + 6, handle_x - 24 : handle_x + 3] = (70, 72, 74)
    image[handle_y + 15 : handle_y + 20, handle_x - 2 : handle_x + 2] = (20, 20, 20)
    image[-round(0.1 * height) :, 4:-4] = (160, 164, 168)
    for hinge in (0.12, 0.85):
        image[round(hinge * height) : round(hinge * height) + 20, :6] = (90, 92, 94)
    return image


def _plate(number: str) -> Texture:
    """A room's number and the names of who works there."""

    def paint(rng: np.random.Generator, height: int, width: int) -> ByteArray:
        image = np.full((height, width, 3), (225, 228, 230), np.uint8)
        image[: round(0.45 * height)] = (110, 70, 30)
        digits = np.random.default_rng(int(number))
        textures.write_text(image, digits, 0.1 * width, 0.08 * height, 0.8 * width, 0.3 * height, (245, 245, 245))
        for row in (0.55, 0.75):
            textures.write_text(image, digits, 0.1 * width, row * height, 0.8 * width, 0.13 * height, (30, 30, 30))
        return image

    return paint


def _plain(base: tuple[int, int, int], strength: float = 0.6) -> Texture:
    return textures.plaster(base, strength)


def _jamb(seed: int) -> dict[str, Paint]:
    """The inside of a doorway; its two open sides have no paint."""
    build = _builder(seed)
    sizes = {"x+": (WALL_M, DOOR_HEIGHT_M), "x-": (WALL_M, DOOR_HEIGHT_M), "z+": (DOOR_WIDTH_M, WALL_M)}
    paints = {face: build.paint("jamb", _plain(_FRAME), *size, _BARE_PX_PER_M) for face, size in sizes.items()}
    return {**paints, "z-": build.paint("sill", _plain((70, 84, 96)), DOOR_WIDTH_M, WALL_M, _FURNITURE_PX_PER_M)}


def _hang(
    build: Builder, name: str, face: str, low: _Triple, size: _Triple, texture: Texture, source: Source | None = None
) -> None:
    """A thin object on a wall or ceiling with its picture on ``face``; a lamp or a window if it has a source."""
    width, height = {"x": (size[1], size[2]), "y": (size[0], size[2]), "z": (size[0], size[1])}[face[0]]
    picture = build.paint(f"{name}/{face}", texture, width, height, _PICTURE_PX_PER_M)
    if source is not None:
        picture = Paint(picture.albedo, (picture.albedo != FRAME_GRAY).any(axis=2), source)
    back = {"x+": "x-", "x-": "x+", "y+": "y-", "y-": "y+", "z-": "z+"}[face]
    rim = {}
    for side in ("x+", "y+", "x-", "y-", "z+", "z-"):
        if side not in (face, back):
            extent = {"x": (size[1], size[2]), "y": (size[0], size[2]), "z": (size[0], size[1])}[side[0]]
            rim[side] = build.paint("rim", _plain((150, 150, 150)), *extent, _BARE_PX_PER_M)
    build.boxes.append(Box(np.array(low) + 0.5 * np.array(size), np.array(size), 0.0, {face: picture, **rim}))


def _frame(build: Builder, face: str, x0: float, y: float, z: float = 0.0) -> None:
    """The frame of an opening with its left edge at ``x0``, on a wall along x with its surface at ``y``."""
    strip, inward = 0.07, 1.0 if face == "y+" else -1.0
    back = y if inward > 0 else y - _THIN_M
    tall = DOOR_HEIGHT_M + strip
    for x, width, bottom, height in (
        (x0 - strip, strip, 0.0, tall),
        (x0 + DOOR_WIDTH_M, strip, 0.0, tall),
        (x0, DOOR_WIDTH_M, DOOR_HEIGHT_M, strip),
    ):
        _hang(build, "frame", face, (x, back, z + bottom), (width, _THIN_M, height), _plain(_FRAME))


# -- the corridor ----------------------------------------------------------------------------------------------------


def _corridor(plan: Plan, storey: int, seed: int) -> Scene:
    """White, long, and the same on both floors but for what hangs there."""
    build = _builder(seed)
    rng = build.rng(f"corridor {storey}")
    size = np.array([plan.length, CORRIDOR_WIDTH_M, ROOM_HEIGHT_M])
    z = storey * STOREY_M
    south, north = plan.corridor_y - 0.5 * CORRIDOR_WIDTH_M, plan.corridor_y + 0.5 * CORRIDOR_WIDTH_M
    walls = {"y+": south, "y-": north}  # the side from which what hangs there is seen
    taken: dict[str, list[tuple[float, float]]] = {"y+": [], "y-": []}

    def hang(
        name: str, face: str, x: float, bottom: float, size: tuple[float, float], texture: Texture, thick: float
    ) -> None:
        width, height = size
        low = (x, walls[face] if face == "y+" else walls[face] - thick, z + bottom)
        _hang(build, name, face, low, (width, thick, height), texture)
        taken[face].append((x - 0.04, x + width + 0.04))

    for room in plan.rooms:
        if room.storey != storey:
            continue
        face = "y+" if room.along == -1 else "y-"
        middle = room.place(room.door, 0)[0]
        left = middle - 0.5 * DOOR_WIDTH_M
        _frame(build, face, left, walls[face], z)
        taken[face].append((left - 0.1, left + DOOR_WIDTH_M + 0.1))
        hang(f"plate {room.name}", face, left - 0.32, 1.45, (0.16, 0.16), _plate(room.name), _THIN_M)
    stairs_left = plan.flight_x[storey] - 0.5 * DOOR_WIDTH_M
    _frame(build, "y-", stairs_left, north, z)
    taken["y-"].append((stairs_left - 0.1, stairs_left + DOOR_WIDTH_M + 0.1))

    def free(width: float, face: str) -> float | None:
        """A place along the wall where nothing hangs yet."""
        for x in rng.uniform(0.3, plan.length - width - 0.3, 40).tolist():
            if all(x + width + 0.1 < a or x - 0.1 > b for a, b in taken[face]):
                return float(x)
        return None

    def scatter(
        count: int,
        name: str,
        bottom: float,
        size: tuple[float, float],
        texture: Texture,
        alike: bool = False,
        thick: float = _THIN_M,
    ) -> None:
        for i in range(count):
            face = "y+" if rng.uniform() < 0.5 else "y-"
            x = free(size[0], face)
            if x is not None:
                own = name if alike else f"{name} {storey} {i}"
                if texture is _door_leaf:
                    _frame(build, face, x, walls[face], z)
                hang(own, face, x, bottom, size, texture, thick)

    scatter(3, "closed door", 0.0, (DOOR_WIDTH_M, DOOR_HEIGHT_M), _door_leaf, alike=True)
    scatter(1, "board", 1.0, (1.2, 0.9), textures.whiteboard)
    scatter(2, "extinguisher", 0.5, (0.18, 0.5), _plain((40, 40, 190)), alike=True, thick=0.16)
    scatter(3, "poster", 1.15, (0.6, 0.84), textures.poster)
    scatter(2, "exit sign", 2.2, (0.34, 0.17), _exit_sign, alike=True)
    scatter(6, "notice", 1.1, (0.3, 0.42), _note)
    scatter(3, "picture", 1.2, (0.5, 0.4), textures.painting)
    scatter(5, "socket", 0.3, (0.16, 0.08), _socket, alike=True)
    scatter(4, "switch", 1.1, (0.09, 0.09), _plain((215, 218, 220)), alike=True)
    lamps = round(plan.length / 3.4)
    for i in range(lamps):
        x = plan.length * (i + 0.5) / lamps - 0.6
        low = (x, plan.corridor_y - 0.15, z + ROOM_HEIGHT_M - _THIN_M)
        _hang(build, "corridor lamp", "z-", low, (1.2, 0.3, _THIN_M), lamp_diffuser, Source.LAMP)
    for face, x in (("x+", 0.0), ("x-", plan.length - _THIN_M)):
        low = (x, plan.corridor_y - 0.5, z + 0.9)
        _hang(build, f"window {storey}{face}", face, low, (_THIN_M, 1.0, 1.4), window_view, Source.WINDOW)
    centre = np.array([0.5 * plan.length, plan.corridor_y, z + 0.5 * ROOM_HEIGHT_M])
    return Scene(Box(centre, size, 0.0, _shell(build, f"corridor {storey}", size, _linoleum)), tuple(build.boxes))


def _exit_sign(rng: np.random.Generator, height: int, width: int) -> ByteArray:
    """White on green."""
    image = np.full((height, width, 3), (70, 130, 20), np.uint8)
    h, w = height // 6, width // 8
    image[2 * h : 4 * h, w : 4 * w] = (240, 245, 240)
    image[h : 5 * h, 4 * w : 5 * w] = (240, 245, 240)
    image[h : 5 * h, 6 * w : 7 * w] = (240, 245, 240)
    return image


# -- the stairs ------------------------------------------------------------------------------------------------------


def _stairwell(plan: Plan, seed: int) -> Scene:
    """Two flights with a landing between, a wall between the flights, open to both corridors."""
    build = _builder(seed)
    x0, y0 = plan.stairs_x, plan.north_y
    height = STOREY_M + ROOM_HEIGHT_M
    size = np.array([STAIRS_WIDTH_M, ROOM_DEPTH_M, height])
    rise = 0.5 * STOREY_M / STEPS
    run_end = STAIRS_ENTRY_M + (STEPS - 1) * STEP_DEPTH_M
    right = x0 + STAIRS_WIDTH_M - FLIGHT_WIDTH_M
    stone = _terrazzo
    for i in range(STEPS - 1):
        top = (i + 1) * rise
        y = y0 + STAIRS_ENTRY_M + i * STEP_DEPTH_M
        build.add("step", (x0, y, 0.0), (FLIGHT_WIDTH_M, STEP_DEPTH_M, top), stone, hidden="z-,x-,x+,y+")
        # The upper flight comes back towards the corridor.
        y = y0 + run_end - (i + 1) * STEP_DEPTH_M
        bottom = 0.5 * STOREY_M + i * rise - 0.12
        build.add("step", (right, y, bottom), (FLIGHT_WIDTH_M, STEP_DEPTH_M, rise + 0.12), stone, hidden="x-,x+")
    landing = (STAIRS_WIDTH_M, ROOM_DEPTH_M - run_end, 0.2)
    build.add("landing", (x0, y0 + run_end, 0.5 * STOREY_M - 0.2), landing, stone, hidden="x-,x+,y+")
    platform = (FLIGHT_WIDTH_M, STAIRS_ENTRY_M, 0.2)
    build.add("platform", (right, y0, STOREY_M - 0.2), platform, stone, hidden="y-,x+")
    gap = STAIRS_WIDTH_M - 2 * FLIGHT_WIDTH_M
    wall = (x0 + FLIGHT_WIDTH_M, y0, 0.0), (gap, run_end, height)
    white = textures.plaster(_WHITE, 0.4)
    build.add("stairs wall", *wall, white, hidden="z-,z+,y-", px_per_m=_BARE_PX_PER_M)
    for side, x in (("x+", x0 + 0.0), ("x-", x0 + STAIRS_WIDTH_M - _THIN_M)):
        y = y0 + STAIRS_ENTRY_M + 0.6
        base = 1.9 if side == "x+" else STOREY_M + 0.5
        _hang(build, f"stairs picture {side}", side, (x, y, base), (_THIN_M, 0.5, 0.7), textures.poster)
    low = (x0 + 0.6, y0 + ROOM_DEPTH_M - _THIN_M, 0.5 * STOREY_M + 1.1)
    _hang(build, "stairs window", "y-", low, (1.3, _THIN_M, 1.2), window_view, Source.WINDOW)
    for storey, x in ((0, x0 + 0.3), (1, right + 0.4)):
        low = (x, y0 + ROOM_DEPTH_M - _THIN_M, 0.5 * STOREY_M + 0.5 + 2.2 * storey)
        _hang(build, f"storey sign {storey}", "y-", low, (0.3, _THIN_M, 0.3), _plate(f"{7 + storey}"))
    for y in (y0 + 0.4, y0 + 3.4):
        for x in (x0 + 0.35, right + 0.35):
            low = (x, y, height - _THIN_M)
            _hang(build, "stairs lamp", "z-", low, (0.6, 0.6, _THIN_M), lamp_diffuser, Source.LAMP)
    _hang(build, "entry lamp", "x+", (x0, y0 + 0.2, 2.3), (_THIN_M, 0.4, 0.2), lamp_diffuser, Source.LAMP)
    for storey, x in enumerate(plan.flight_x):
        _frame(build, "y+", x - 0.5 * DOOR_WIDTH_M, y0, storey * STOREY_M)
    paints = _shell(build, "stairs", size, _terrazzo)
    centre = np.array([x0, y0, 0.0]) + 0.5 * size
    return Scene(Box(centre, size, 0.0, paints), tuple(build.boxes))


def _terrazzo(rng: np.random.Generator, height: int, width: int) -> ByteArray:
    """Cast stone with light and dark chips, a worn edge in front."""
    field_ = textures.noise(rng, height, width, 5, 5)
    image = textures.shaded((150, 156, 160), 0.03 * textures.noise(rng, height, width, 40, 40))
    image[field_ > 1.7] = (205, 210, 214)
    image[field_ < -1.8] = (104, 108, 112)
    image[-4:] = (110, 114, 118)
    return image


# -- the rooms -------------------------------------------------------------------------------------------------------


def _furnished(plan: RoomPlan, kind: str, seed: int) -> Scene:
    """A room with a window opposite the door, furnished as its kind is; built upright, then turned into its place."""
    build = _builder(seed)
    rng = build.rng(f"plan of {plan.name}")
    size = np.array([plan.width, ROOM_DEPTH_M, ROOM_HEIGHT_M])
    room = _Room(build, rng, plan.name, plan.width, ROOM_DEPTH_M, plan.door)
    room.common()
    getattr(room, kind)()
    room.clutter()
    accent = {}
    if rng.uniform() < 0.35:
        accent["x-" if rng.uniform() < 0.5 else "x+"] = _plain(color(rng.uniform(), 0.22, 0.78), 0.5)
    floors: dict[str, Texture] = {
        "office": _carpet((112, 104, 98)),
        "meeting": _carpet((112, 104, 98)),
        "lounge": textures.planks((96, 140, 176), 20),
        "bedroom": textures.planks((96, 140, 176), 20),
    }
    shell = _shell(build, f"room {plan.name}", size, floors.get(kind, _linoleum), accent)
    yaw = 0.0 if plan.along == 1 else np.pi
    turn = np.diag([float(plan.along), float(plan.along), 1.0])
    corner = plan.place(0, 0)
    boxes = tuple(Box(turn @ box.centre + corner, box.size, box.yaw + yaw, box.paints) for box in build.boxes)
    return Scene(Box(turn @ (0.5 * size) + corner, size, yaw, shell), boxes)


@dataclass
class _Room:
    """Furnishes a room in its own axes: x along the door's wall, y into the room, the middle stays free to walk."""

    build: Builder
    rng: np.random.Generator
    name: str
    width: float
    depth: float
    door: float

    oak = (96, 140, 176)
    grey = (150, 150, 148)

    def common(self) -> None:
        """What every room has: lamps, a window with its radiator, the door's leaf and frame, a switch."""
        for x in (0.3, 0.7) if self.width > 4.6 else (0.5,):
            low = (x * self.width - 0.3, 0.5 * self.depth - 0.3, ROOM_HEIGHT_M - _THIN_M)
            self.hang("lamp", "z-", low, (0.6, 0.6, _THIN_M), lamp_diffuser, Source.LAMP)
        wide = min(1.8, self.width - 2.2)
        x = 0.5 * (self.width - wide) + self.jitter(0.2)
        low = (x, self.depth - _THIN_M, 1.0)
        self.hang(f"{self.name} window", "y-", low, (wide, _THIN_M, 1.35), window_view, Source.WINDOW)
        left = self.door - 0.5 * DOOR_WIDTH_M
        leaf = (left - 0.045, _THIN_M + 0.01, 0.0), (0.04, 0.87, 2.03)
        self.build.add("leaf", *leaf, _plain((206, 214, 216)), front={"x-": _door_leaf, "x+": _door_leaf})
        _frame(self.build, "y+", left, 0.0)
        switch = (self.door + 0.62, 0.0, 1.1)
        self.hang("switch", "y+", switch, (0.09, _THIN_M, 0.09), _plain((215, 218, 220)))

    def office(self) -> None:
        """Two desks under the window, a shelf, a cupboard."""
        for i, x in enumerate((0.25, self.width - 1.85)):
            self.desk(x, self.depth - 0.75, f"{self.name} desk {i}")
        self.shelf(1.15, 4)
        self.cupboard(self.width - 0.45, 0.6)
        self.picture("x+", 1.9, textures.whiteboard, (1.2, 0.85))
        self.picture("y+", self.door + 1.0, textures.poster, (0.5, 0.7))

    def meeting(self) -> None:
        """A table in the middle, boards on the walls, chairs along them."""
        x, y = 0.5 * self.width - 0.45, 0.5 * self.depth - 0.35
        self.build.add("meeting table", (x, y, 0.70), (0.9, 0.6, 0.04), textures.wood(self.oak), hidden="")
        self.build.add("table foot", (x + 0.4, y + 0.25, 0.0), (0.1, 0.1, 0.70), _plain((60, 60, 62)), hidden="z-,z+")
        self.build.add(f"{self.name} papers", (x + 0.2, y + 0.15, 0.74), (0.3, 0.22, 0.03), textures.whiteboard)
        self.picture("x+", 1.4, textures.whiteboard, (1.6, 1.0))
        self.picture("x-", 1.9, textures.screen, (1.1, 0.65))
        for i in range(3):
            self.chair(self.width - 0.55, 0.7 + 0.75 * i)
        self.radiator()

    def lounge(self) -> None:
        """A sofa, paintings, a shelf of books, a plant."""
        upholstery = _carpet(textures.random_color(self.build.rng("sofa"), (0.3, 0.5), (0.4, 0.6)))
        self.build.add("sofa back", (0.02, 1.2, 0.0), (0.2, 1.7, 0.82), upholstery, hidden="z-,x-")
        self.build.add("sofa seat", (0.22, 1.2, 0.0), (0.55, 1.7, 0.42), upholstery, hidden="z-,x-")
        cushion = (0.24, 1.3 + self.rng.uniform(0, 0.9), 0.42), (0.14, 0.42, 0.36)
        self.build.add(f"{self.name} cushion", *cushion, textures.fabric_pattern, hidden="z-,x-")
        self.picture("x-", 1.4, textures.painting, (1.0, 0.7))
        add_bookshelf(self.build, f"{self.name} shelf", (self.width - 1.6, self.depth - 0.3), (1.5, 0.28), self.oak, 2)
        self.build.add("plant pot", (self.width - 0.45, 1.0, 0.0), (0.32, 0.32, 0.36), _plain((80, 90, 120)))
        self.build.add("plant", (self.width - 0.5, 0.95, 0.36), (0.42, 0.42, 0.7), _foliage)
        self.picture("x+", 2.0, textures.painting, (0.8, 0.6))

    def kitchen(self) -> None:
        """A counter with cupboards above, a fridge, a small table."""
        wide = self.width - 1.4
        front = textures.panel((214, 220, 222), 4, 1)
        counter = (0.3, self.depth - 0.62, 0.0), (wide, 0.6, 0.9)
        self.build.add("counter", *counter, _plain((200, 204, 206)), hidden="z-,y+", front={"y-": front})
        for i, share in enumerate((0.12, 0.45, 0.8)):
            low = (0.3 + share * wide, self.depth - 0.45, 0.9)
            self.build.add(f"{self.name} jar {i}", low, (0.16, 0.16, 0.24), textures.cardboard, yaw=0.3 * i)
        fridge = (self.width - 0.66, self.depth - 0.68, 0.0), (0.62, 0.64, 1.75)
        self.build.add("fridge", *fridge, _plain((222, 224, 224)), hidden="z-,y+", front={"y-": _door_leaf})
        self.picture("x-", 1.4, textures.poster, (0.5, 0.7))
        self.build.add("bin", (self.width - 0.4, 0.9, 0.0), (0.32, 0.32, 0.55), _plain((110, 112, 110)))
        self.shelf(1.9, 3, short=True)
        self.picture("x+", 1.6, textures.whiteboard, (0.7, 0.5))

    def storage(self) -> None:
        """Shelves full of boxes."""
        for i in range(4):
            y, tall = 1.1 + 0.62 * i, float(self.rng.uniform(0.35, 0.55))
            self.build.add(f"{self.name} box {i}", (0.03, y, 0.0), (0.5, 0.55, tall), textures.cardboard)
            if self.rng.uniform() < 0.7:
                on = (0.06, y + 0.05, tall), (0.42, 0.42, float(self.rng.uniform(0.25, 0.4)))
                self.build.add(f"{self.name} box on {i}", *on, textures.cardboard, yaw=self.jitter(0.08))
        for i in range(2):
            self.cupboard(self.width - 0.45, 0.5 + 1.0 * i)
        self.build.add(f"{self.name} stack", (self.width - 0.75, 2.7, 0.0), (0.6, 0.6, 0.9), textures.cardboard)
        self.radiator()

    def workshop(self) -> None:
        """A bench with tools, lockers."""
        self.build.add("bench top", (0.02, 1.1, 0.86), (0.65, 2.2, 0.05), textures.wood(self.oak), hidden="x-")
        for y in (1.15, 3.2):
            self.build.add("bench leg", (0.1, y, 0.0), (0.5, 0.06, 0.86), _plain((80, 80, 82)), hidden="z-,z+")
        for i in range(3):
            low = (0.12, 1.25 + 0.65 * i + self.jitter(0.05), 0.91)
            tools = (0.3, 0.3, float(self.rng.uniform(0.12, 0.3)))
            self.build.add(f"{self.name} case {i}", low, tools, textures.cardboard, yaw=self.jitter(0.4))
        self.picture("x-", 1.3, textures.books, (1.6, 0.6))
        for i in range(3):
            low = (self.width - 0.46, 0.7 + 0.5 * i, 0.0)
            self.build.add("locker", low, (0.45, 0.49, 1.8), _plain(self.grey), hidden="z-,x+", front={"x-": _locker})
        self.desk(self.width - 1.85, self.depth - 0.75, f"{self.name} desk")

    def bedroom(self) -> None:
        """A bed, a wardrobe, pictures."""
        self.build.add(
            "mattress", (self.width - 0.92, 1.6, 0.0), (0.9, 2.0, 0.45), _carpet((190, 196, 200)), hidden="z-,x+"
        )
        quilt = (self.width - 0.93, 1.6, 0.45), (0.9, 1.4, 0.12)
        self.build.add(f"{self.name} quilt", *quilt, textures.fabric_pattern, hidden="z-,x+")
        self.build.add("pillow", (self.width - 0.8, 3.1, 0.45), (0.6, 0.4, 0.13), _carpet((220, 224, 226)))
        self.build.add("bedside table", (self.width - 0.45, 3.75, 0.0), (0.4, 0.4, 0.5), textures.wood(self.oak))
        self.build.add(f"{self.name} books", (self.width - 0.4, 3.8, 0.5), (0.25, 0.2, 0.12), textures.books)
        for i in range(2):
            self.wardrobe(1.15 + 1.0 * i)
        self.picture("x+", 2.2, textures.painting, (0.9, 0.6))
        self.radiator()

    def clutter(self) -> None:
        """Notes, calendars and sockets on the walls, bags and cartons on the floor, wherever there is space."""
        papers = (textures.whiteboard, textures.poster, textures.painting, _note)
        for i in range(_NOTES):
            wide, tall = self.rng.uniform(0.15, 0.36), self.rng.uniform(0.15, 0.42)
            bottom = float(self.rng.uniform(1.0, 1.9 - 0.5 * tall))
            self.on_wall(f"{self.name} note {i}", bottom, (wide, tall), papers[int(self.rng.integers(len(papers)))])
        for _ in range(_SOCKETS):
            self.on_wall("socket", 0.3, (0.16, 0.08), _socket)
        for i in range(_BAGS):
            size = self.rng.uniform(0.22, 0.4, 3)
            for _ in range(_TRIES):
                along = self.rng.uniform(0.05, 0.95)
                x, y = along * (self.width - size[0]), along * (self.depth - size[1])
                side = int(self.rng.integers(3))
                low = [(0.05, y), (self.width - size[0] - 0.05, y), (x, self.depth - size[1] - 0.12)][side]
                place = np.array([*low, 0.0])
                if self.is_free(place, size):
                    own: Texture = textures.cardboard if self.rng.uniform() < 0.5 else textures.fabric_pattern
                    a, b = place.tolist(), size.tolist()
                    self.build.add(f"{self.name} bag {i}", (a[0], a[1], a[2]), (b[0], b[1], b[2]), own)
                    break

    def on_wall(self, name: str, bottom: float, size: tuple[float, float], texture: Texture) -> None:
        """Something small on one of the three walls without a window, where it covers nothing."""
        wide, tall = size
        for _ in range(_TRIES):
            share = float(self.rng.uniform())
            x, y = share * (self.width - wide), share * (self.depth - wide)
            places: list[tuple[_Triple, _Triple, str]] = [
                ((0.0, y, bottom), (_THIN_M, wide, tall), "x+"),
                ((self.width - _THIN_M, y, bottom), (_THIN_M, wide, tall), "x-"),
                ((x, 0.0, bottom), (wide, _THIN_M, tall), "y+"),
            ]
            low, extent, seen = places[int(self.rng.integers(3))]
            if self.is_free(np.array(low), np.array(extent)):
                self.hang(name, seen, low, extent, texture)
                return

    def is_free(self, low: FloatArray, size: FloatArray) -> bool:
        """Whether a box would touch nothing, nor stand in or cover the door."""
        door = np.array([self.door - 0.6, 0.0, 0.0]), np.array([self.door + 0.6, 1.3, 2.2])
        others = [door, *((box.corners.min(axis=0), box.corners.max(axis=0)) for box in self.build.boxes)]
        return not any(((low < high + _APART_M) & (low + size > start - _APART_M)).all() for start, high in others)

    # What recurs in several rooms.

    def desk(self, x: float, y: float, name: str) -> None:
        """A desk with a screen, papers, a chair beside it."""
        self.build.add("desk top", (x, y, 0.70), (1.6, 0.7, 0.03), textures.wood(self.oak), hidden="")
        for dx in (0.05, 1.5):
            self.build.add("desk leg", (x + dx, y + 0.05, 0.0), (0.05, 0.6, 0.70), _plain((90, 90, 92)), hidden="z-,z+")
        screen = (x + 0.45 + self.jitter(0.15), y + 0.4, 0.83), (0.55, 0.05, 0.34)
        self.build.add("monitor", *screen, _plain((40, 40, 42)), hidden="", front={"y-": textures.screen})
        self.build.add("monitor foot", (screen[0][0] + 0.2, y + 0.4, 0.73), (0.15, 0.15, 0.1), _plain((50, 50, 52)))
        papers = (x + 1.25 + self.jitter(0.05), y + 0.15, 0.73), (0.25, 0.3, float(self.rng.uniform(0.03, 0.16)))
        self.build.add(f"{name} papers", *papers, textures.books if self.rng.uniform() < 0.5 else textures.whiteboard)
        self.build.add(
            f"{name} things", (x + 0.12, y + 0.2, 0.73), (0.14, 0.14, 0.16), textures.poster, yaw=self.jitter(0.5)
        )

    def chair(self, x: float, y: float) -> None:
        """A seat and a back against the right wall."""
        self.build.add("chair seat", (x, y, 0.42), (0.44, 0.44, 0.05), _carpet((120, 80, 50)), hidden="")
        self.build.add("chair back", (x + 0.46, y, 0.42), (0.04, 0.44, 0.48), _carpet((120, 80, 50)), hidden="")
        self.build.add("chair post", (x + 0.18, y + 0.18, 0.0), (0.08, 0.08, 0.42), _plain((60, 60, 64)))

    def shelf(self, y: float, levels: int, short: bool = False) -> None:
        """Books along the left wall."""
        add_bookshelf(self.build, f"{self.name} shelf", (0.0, y), (0.28, 0.9 if short else 1.5), self.oak, levels)

    def cupboard(self, x: float, y: float) -> None:
        """Of one make throughout the building, along the right wall, a box on it."""
        low = (x, y, 0.0)
        self.build.add("cupboard", low, (0.43, 0.9, 1.3), _plain(self.grey), hidden="z-,x+", front={"x-": _locker})
        on = (x + 0.05, y + 0.1 + self.rng.uniform(0, 0.3), 1.3), (0.32, 0.4, 0.28)
        self.build.add(f"{self.name} on cupboard {y:.1f}", *on, textures.cardboard)

    def wardrobe(self, y: float) -> None:
        """White, of one make, along the left wall."""
        self.build.add(
            "wardrobe", (0.0, y, 0.0), (0.55, 0.98, 2.1), _plain((214, 220, 222)), hidden="z-,x-", front={"x+": _locker}
        )

    def radiator(self) -> None:
        """Under the window."""
        low = (0.5 * self.width - 0.6, self.depth - 0.1, 0.15)
        self.build.add(
            "radiator", low, (1.2, 0.08, 0.6), _plain((225, 228, 228)), hidden="y+", front={"y-": radiator_ribs}
        )

    def picture(self, face: str, along: float, texture: Texture, size: tuple[float, float]) -> None:
        """Something of this room's own on a wall; ``face`` is where the wall is, ``along`` its left edge."""
        bottom = 1.45 - 0.3 * size[1] + self.jitter(0.08)
        places: dict[str, tuple[_Triple, _Triple, str]] = {
            "x-": ((0.0, along, bottom), (_THIN_M, *size), "x+"),
            "x+": ((self.width - _THIN_M, along, bottom), (_THIN_M, *size), "x-"),
            "y+": ((along, 0.0, bottom), (size[0], _THIN_M, size[1]), "y+"),
        }
        low, extent, seen = places[face]
        self.hang(f"{self.name} picture {face}", seen, low, extent, texture)

    def hang(
        self, name: str, face: str, low: _Triple, size: _Triple, texture: Texture, source: Source | None = None
    ) -> None:
        """A thin thing on a wall or the ceiling, see :func:`_hang`."""
        _hang(self.build, name, face, low, size, texture, source)

    def jitter(self, scale: float) -> float:
        return float(self.rng.uniform(-scale, scale))


def _note(rng: np.random.Generator, height: int, width: int) -> ByteArray:
    """A sheet of small print."""
    image = np.full((height, width, 3), (228, 234, 236), np.uint8)
    image[0] = image[-1] = image[:, 0] = image[:, -1] = (150, 150, 150)
    for row in range(6, height - 8, 8):
        textures.write_text(image, rng, 5, row, (width - 10) * rng.uniform(0.3, 1), 5, (50, 50, 50))
    return image


def _socket(rng: np.random.Generator, height: int, width: int) -> ByteArray:
    """Two sockets side by side; every one in the building looks like this."""
    image = np.full((height, width, 3), (214, 218, 220), np.uint8)
    for x in (width // 4, 3 * width // 4):
        cv2.circle(image, (x, height // 2), height // 3, (150, 154, 156), 1, cv2.LINE_AA)
        for dx in (-3, 3):
            image[height // 2 - 1 : height // 2 + 1, x + dx - 1 : x + dx + 1] = (30, 30, 30)
    return image


def _foliage(rng: np.random.Generator, height: int, width: int) -> ByteArray:
    """Leaves."""
    crown = textures.noise(rng, height, width, 12, 8)
    image = textures.shaded((50, 96, 60), 0.3 * crown)
    image[crown < -0.9] = (20, 34, 24)
    return image


def _locker(rng: np.random.Generator, height: int, width: int) -> ByteArray:
    """A smooth front with slits and a handle."""
    image = textures.shaded((168, 172, 172), 0.01 * textures.noise(rng, height, width, 100, 100))
    image[:2] = image[-2:] = image[:, :2] = image[:, -2:] = (110, 112, 112)
    image[:, width // 2 - 1 : width // 2 + 1] = (110, 112, 112)
    for i in range(4):
        y = round((0.08 + 0.025 * i) * height)
        image[y : y + 3, width // 6 : width // 3] = (70, 72, 72)
    image[height // 2 : height // 2 + 16, width // 2 + 6 : width // 2 + 12] = (60, 60, 60)
    return image

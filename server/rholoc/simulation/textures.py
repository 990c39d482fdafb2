"""Paint for walls, floors and furniture, all drawn at random from a seed: no two faces look alike.

Images are (H, W, 3) BGR bytes, gamma-encoded reflectance; sizes are pixels.
"""

import colorsys
from collections.abc import Callable

import cv2
import numpy as np

from rholoc.geometry import ByteArray, FloatArray

Rng = np.random.Generator
Texture = Callable[[Rng, int, int], ByteArray]  # (rng, height, width) → image
_SHIFT = 4  # OpenCV's sub-pixel bits


def color(hue: float, saturation: float, value: float) -> tuple[int, int, int]:
    """BGR bytes of a colour given by hue, saturation and value, each 0..1."""
    r, g, b = colorsys.hsv_to_rgb(hue % 1.0, min(max(saturation, 0.0), 1.0), min(max(value, 0.0), 1.0))
    return round(255 * b), round(255 * g), round(255 * r)


def random_color(
    rng: Rng, saturation: tuple[float, float] = (0.4, 0.95), value: tuple[float, float] = (0.3, 0.9)
) -> tuple[int, int, int]:
    """BGR bytes of a colour of any hue, its saturation and value in these ranges (within 0..1)."""
    return color(rng.uniform(), rng.uniform(*saturation), rng.uniform(*value))


def noise(rng: Rng, height: int, width: int, cell_y: float, cell_x: float) -> FloatArray:
    """Smooth noise (H, W) float32 of unit variance whose features are about ``cell_y`` × ``cell_x`` pixels large."""
    rows, columns = max(2, round(height / cell_y) + 2), max(2, round(width / cell_x) + 2)
    field = rng.standard_normal((rows, columns)).astype(np.float32)
    smooth = cv2.resize(field, (width, height), interpolation=cv2.INTER_CUBIC)
    return np.asarray(smooth / max(float(smooth.std()), 1e-6))


def shaded(base: tuple[int, int, int], shade: FloatArray) -> ByteArray:
    """Image (H, W, 3) of the colour ``base`` (BGR) times (1 + ``shade`` (H, W)), clipped to bytes."""
    image = (1 + shade)[..., None] * np.array(base, np.float32)
    return np.asarray(np.clip(image, 0, 255).astype(np.uint8))


def plaster(base: tuple[int, int, int], strength: float = 1.0) -> Texture:
    """Texture of a wall painted ``base`` (BGR): stains too large and grain too fine to give features."""

    def paint(rng: Rng, height: int, width: int) -> ByteArray:
        shade = 0.015 * noise(rng, height, width, 300, 300) + 0.008 * noise(rng, height, width, 12, 12)
        shade += 0.006 * noise(rng, height, width, 2.5, 2.5)
        return shaded(base, strength * shade)

    return paint


def wood(base: tuple[int, int, int], vertical: bool = False) -> Texture:
    """Texture of wood of colour ``base`` (BGR), its grain along the width or ``vertical``, with knots."""

    def paint(rng: Rng, height: int, width: int) -> ByteArray:
        if vertical:
            return np.ascontiguousarray(np.rot90(wood(base)(rng, width, height)))
        y = np.linspace(0, height / 70.0, height, dtype=np.float32)[:, None]
        wave = y + 0.5 * noise(rng, height, width, 60, 400) + 0.1 * noise(rng, height, width, 10, 160)
        for _ in range(max(1, height * width // 90000)):
            cy, cx, r = rng.uniform(0, height), rng.uniform(0, width), rng.uniform(8, 26)
            dy, dx = np.ogrid[:height, :width]
            wave += 3 * np.exp(-(((dy - cy) / r) ** 2 + ((dx - cx) / (2.2 * r)) ** 2).astype(np.float32))
        rings = np.abs(np.modf(wave)[0])
        shade = -0.22 * rings + 0.05 * noise(rng, height, width, 1.6, 40) + 0.03 * noise(rng, height, width, 40, 200)
        return shaded(base, shade)

    return paint


def fabric(base: tuple[int, int, int]) -> Texture:
    """Texture of woven cloth with flecks and faded places; ``base`` is its colour as BGR bytes."""

    def paint(rng: Rng, height: int, width: int) -> ByteArray:
        shade = 0.08 * noise(rng, height, width, 3, 3) + 0.05 * noise(rng, height, width, 60, 60)
        image = shaded(base, shade)
        for _ in range(height * width // 3500):
            at = (int(rng.integers(width)), int(rng.integers(height)))
            cv2.ellipse(
                image,
                at,
                (int(rng.integers(2, 9)), int(rng.integers(1, 4))),
                rng.uniform(0, 180),
                0,
                360,
                random_color(rng, (0.2, 0.7)),
                -1,
                cv2.LINE_AA,
            )
        return image

    return paint


def planks(base: tuple[int, int, int], plank_px: int = 36) -> Texture:
    """Texture of a parquet floor of colour ``base`` (BGR): planks ``plank_px`` wide of different tone and length."""

    def paint(rng: Rng, height: int, width: int) -> ByteArray:
        shade = 0.05 * noise(rng, height, width, 2, 60) + 0.03 * noise(rng, height, width, 200, 200)
        for top in range(0, height, plank_px):
            left = -int(rng.integers(0, 300))
            while left < width:
                right = left + int(rng.integers(160, 420))
                tone = shade[top : top + plank_px, max(left, 0) : max(right, 0)]
                tone += rng.normal(0, 0.09)
                tone[:1] -= 0.3
                tone[:, :1] -= 0.3
                left = right
        for _ in range(height * width // 9000):  # scratches, crumbs, stains
            at = rng.uniform((0, 0), (width, height))
            end = at + rng.normal(0, 9, 2)
            cv2.line(
                shade, at.astype(int).tolist(), end.astype(int).tolist(), float(rng.uniform(-0.4, 0.3)), 1, cv2.LINE_AA
            )
        return shaded(base, shade)

    return paint


def write_text(
    image: ByteArray, rng: Rng, left: float, top: float, width: float, glyph_px: float, ink: tuple[int, int, int]
) -> None:
    """Draw a line of invented letters ``glyph_px`` high into ``image``, from (left, top), up to ``width`` px."""
    x = left
    thickness = max(1, round(glyph_px / 9))
    while x + 0.7 * glyph_px < left + width:
        if rng.uniform() < 0.16:
            x += 0.5 * glyph_px
            continue
        points = rng.integers(0, 3, (int(rng.integers(3, 6)), 2)) / 2.0
        pixels = np.column_stack([x + 0.55 * glyph_px * points[:, 0], top + glyph_px * points[:, 1]])
        cv2.polylines(
            image, [np.round(pixels * 2**_SHIFT).astype(np.int32)], False, ink, thickness, cv2.LINE_AA, _SHIFT
        )
        x += 0.75 * glyph_px


def poster(rng: Rng, height: int, width: int) -> ByteArray:
    """Image (H, W, 3) BGR of saturated shapes on a graded ground, with a headline and small print."""
    top, bottom = (
        np.array(random_color(rng, (0.1, 0.8), (0.35, 0.95))),
        np.array(random_color(rng, (0.1, 0.8), (0.35, 0.95))),
    )
    ramp = np.linspace(0, 1, height)[:, None, None]
    image = np.ascontiguousarray(np.broadcast_to(top * (1 - ramp) + bottom * ramp, (height, width, 3)).astype(np.uint8))
    size = min(height, width)
    for _ in range(int(rng.integers(22, 40))):
        centre = rng.uniform((0, 0), (width, height))
        radius = size * rng.uniform(0.02, 0.2) * rng.uniform(0.5, 1)
        ink = random_color(rng)
        kind = rng.integers(4)
        if kind == 0:
            cv2.circle(image, centre.astype(int).tolist(), max(2, int(radius)), ink, -1, cv2.LINE_AA)
        elif kind == 1:
            cv2.circle(
                image, centre.astype(int).tolist(), max(3, int(radius)), ink, max(1, int(radius / 4)), cv2.LINE_AA
            )
        else:
            angles = np.sort(rng.uniform(0, 2 * np.pi, int(rng.integers(3, 7))))
            lengths = radius * rng.uniform(0.5, 1.5, len(angles))
            points = centre + lengths[:, None] * np.column_stack([np.cos(angles), np.sin(angles)])
            cv2.fillPoly(image, [points.astype(np.int32)], ink, cv2.LINE_AA)
    line, at = max(6.0, 0.09 * size), 0.05 * height
    for scale in (1.0, *([0.42] * int(rng.integers(2, 6)))):
        ink = color(0, 0, rng.choice([0.05, 0.95]))
        write_text(image, rng, 0.07 * width, at, width * rng.uniform(0.5, 0.86), scale * line, ink)
        at = at + 1.6 * scale * line if rng.uniform() < 0.7 else rng.uniform(0.3, 0.85) * height
    cv2.rectangle(image, (0, 0), (width - 1, height - 1), color(0, 0, rng.choice([0.1, 0.92])), max(2, size // 60))
    return image


def painting(rng: Rng, height: int, width: int) -> ByteArray:
    """Image (H, W, 3) BGR of a framed picture: layered hills under a sky, brush strokes all over."""
    sky = np.array(color(rng.uniform(0.5, 0.7), 0.45, 0.9), np.float32)
    image = np.ascontiguousarray(np.broadcast_to(sky, (height, width, 3)))
    rows = np.arange(height)[:, None]
    for layer in range(5):
        ridge = height * (0.3 + 0.14 * layer) + 0.07 * height * noise(rng, 1, width, 1, width / 6)[0]
        image[rows > ridge] = random_color(rng, (0.3, 0.8), (0.25, 0.75))
    image *= (1 + 0.10 * noise(rng, height, width, 4, 9) + 0.10 * noise(rng, height, width, 14, 22))[..., None]
    picture = np.clip(image, 0, 255).astype(np.uint8)
    for _ in range(height * width // 700):
        at = rng.uniform((0, 0), (width, height))
        end = at + rng.normal(0, 7, 2)
        ink = np.clip(
            picture[int(at[1]), int(at[0])].astype(float) * rng.uniform(0.6, 1.5) + rng.normal(0, 12, 3), 0, 255
        )
        cv2.line(picture, at.astype(int).tolist(), end.astype(int).tolist(), ink.tolist(), 2, cv2.LINE_AA)
    cv2.rectangle(
        picture,
        (0, 0),
        (width - 1, height - 1),
        color(0.08, 0.6, rng.uniform(0.15, 0.5)),
        max(4, min(height, width) // 14),
    )
    return picture


def books(rng: Rng, height: int, width: int) -> ByteArray:
    """Image (H, W, 3) BGR of a row of spines of all colours and heights, titles on them, the shelf's shadow above."""
    image = np.full((height, width, 3), 28, np.uint8)
    left = 0
    while left < width:
        right = min(width, left + int(rng.integers(7, 21)))
        if rng.uniform() < 0.05:
            left += int(rng.integers(4, 22))
            continue
        top = int(height * rng.uniform(0.05, 0.35))
        ink = random_color(rng, (0.1, 0.9), (0.2, 0.9))
        image[top:, left:right] = ink
        image[top:, left : left + 1] = (0.45 * np.array(ink)).astype(np.uint8)
        trim = random_color(rng, (0.0, 0.9), (0.05, 1.0))
        for _ in range(int(rng.integers(1, 4))):
            band = int(rng.uniform(top, height))
            image[band : band + int(rng.integers(2, 9)), left + 1 : right] = trim
        y = top + 0.15 * (height - top)
        while y < top + rng.uniform(0.4, 0.9) * (height - top):
            write_text(image, rng, left + 2, y, right - left - 2, max(3.0, 0.6 * (right - left)), trim)
            y += max(4.0, 0.8 * (right - left))
        left = right
    return image


def cardboard(rng: Rng, height: int, width: int) -> ByteArray:
    """Image (H, W, 3) BGR of a box's side: tape, a label with small print, a big stamp."""
    base = color(0.085 + rng.normal(0, 0.012), rng.uniform(0.35, 0.55), rng.uniform(0.55, 0.75))
    image = shaded(base, 0.03 * noise(rng, height, width, 60, 60) + 0.02 * noise(rng, height, width, 1.5, 14))
    tape = int(width * rng.uniform(0.3, 0.7))
    image[:, tape : tape + max(4, width // 9)] = random_color(rng, (0.1, 0.6), (0.5, 0.85))
    for _ in range(3):
        w, h = int(width * rng.uniform(0.2, 0.45)), int(height * rng.uniform(0.15, 0.35))
        x, y = int(rng.uniform(0, width - w)), int(rng.uniform(0, height - h))
        image[y : y + h, x : x + w] = random_color(rng, (0.0, 0.6), (0.7, 0.97))
        for row in range(y + 3, y + h - 5, 7):
            write_text(image, rng, x + 3, row, (w - 6) * rng.uniform(0.4, 1), 5, (30, 30, 30))
    write_text(
        image,
        rng,
        0.1 * width,
        0.6 * height,
        0.8 * width,
        0.18 * min(height, width),
        random_color(rng, (0.6, 1), (0.2, 0.6)),
    )
    return image


def panel(base: tuple[int, int, int], columns: int = 2, rows: int = 1) -> Texture:
    """Texture of a cupboard or door of colour ``base`` (BGR): ``columns`` × ``rows`` panels, handles, stickers."""

    def paint(rng: Rng, height: int, width: int) -> ByteArray:
        image = wood(base, vertical=height > width)(rng, height, width)
        for i in range(rows):
            for j in range(columns):
                x0, x1 = j * width // columns + 5, (j + 1) * width // columns - 6
                y0, y1 = i * height // rows + 5, (i + 1) * height // rows - 6
                cv2.rectangle(image, (x0, y0), (x1, y1), color(0.08, 0.5, 0.12), 2)
                inset = max(6, min(x1 - x0, y1 - y0) // 8)
                cv2.rectangle(
                    image, (x0 + inset, y0 + inset), (x1 - inset, y1 - inset), (0.7 * np.array(base)).tolist(), 2
                )
                handle = (x1 - 12 if j % 2 == 0 else x0 + 12, (y0 + y1) // 2)
                cv2.rectangle(image, handle, (handle[0] + 5, handle[1] + 26), color(0.12, 0.1, 0.8), -1)
        for _ in range(int(rng.integers(3, 7))):
            size = int(rng.integers(14, 40))
            if width > size + 2 and height > size + 2:
                x, y = int(rng.integers(width - size)), int(rng.integers(height - size))
                image[y : y + size, x : x + size] = cv2.resize(
                    poster(rng, 64, 64), (size, size), interpolation=cv2.INTER_AREA
                )
        return image

    return paint


def cushions(base: tuple[int, int, int]) -> Texture:
    """Texture of upholstery of colour ``base`` (BGR) with seams and, above 90 px a side, cushions."""
    columns = 3

    def paint(rng: Rng, height: int, width: int) -> ByteArray:
        image = fabric(base)(rng, height, width)
        for j in range(1, columns):
            cv2.line(
                image,
                (j * width // columns, 0),
                (j * width // columns, height),
                (0.5 * np.array(base)).tolist(),
                3,
                cv2.LINE_AA,
            )
        if min(height, width) > 90:
            for j in range(columns):
                size = int(min(height, width / columns) * rng.uniform(0.45, 0.75))
                x = int(j * width / columns + rng.uniform(0, width / columns - size))
                y = int(rng.uniform(0, height - size))
                image[y : y + size, x : x + size] = fabric_pattern(rng, size, size)
        return image

    return paint


def fabric_pattern(rng: Rng, height: int, width: int) -> ByteArray:
    """Image (H, W, 3) BGR of bands and blots of a few matching colours, as on a rug or a cushion."""
    inks = [random_color(rng, (0.3, 0.8), (0.25, 0.85)) for _ in range(5)]
    image = np.full((height, width, 3), inks[0], np.uint8)
    for ink in inks[1:]:
        field = noise(rng, height, width, rng.uniform(12, 50), rng.uniform(12, 50))
        image[np.abs(field - rng.uniform(-0.8, 0.8)) < rng.uniform(0.12, 0.35)] = ink
    grain = 1 + 0.07 * noise(rng, height, width, 2, 2)
    return np.clip(image * grain[..., None], 0, 255).astype(np.uint8)


def whiteboard(rng: Rng, height: int, width: int) -> ByteArray:
    """Image (H, W, 3) BGR of handwriting, boxes and arrows on white."""
    image = shaded((236, 238, 236), 0.01 * noise(rng, height, width, 50, 50))
    for _ in range(6):
        ink = random_color(rng, (0.7, 1.0), (0.2, 0.7))
        x, y = rng.uniform((0.05 * width, 0.08 * height), (0.6 * width, 0.8 * height))
        for row in range(int(rng.integers(1, 4))):
            write_text(image, rng, x, y + 24 * row, rng.uniform(0.15, 0.35) * width, rng.uniform(11, 19), ink)
    for _ in range(9):
        ink = random_color(rng, (0.7, 1.0), (0.2, 0.7))
        start, end = (
            rng.uniform((0.05 * width, 0.1 * height), (0.95 * width, 0.9 * height), (2, 2)).astype(int).tolist()
        )
        if rng.uniform() < 0.5:
            cv2.arrowedLine(image, start, end, ink, 2, cv2.LINE_AA, 0, 0.08)
        else:
            cv2.rectangle(
                image,
                start,
                (start[0] + int(rng.integers(30, 90)), start[1] + int(rng.integers(20, 60))),
                ink,
                2,
                cv2.LINE_AA,
            )
    cv2.rectangle(image, (0, 0), (width - 1, height - 1), (150, 150, 150), 7)
    return image


def screen(rng: Rng, height: int, width: int) -> ByteArray:
    """Image (H, W, 3) BGR of a monitor: windows with text on a desktop picture."""
    image = painting(rng, height, width)
    for _ in range(3):
        w, h = int(width * rng.uniform(0.3, 0.55)), int(height * rng.uniform(0.3, 0.6))
        x, y = int(rng.uniform(6, width - w - 6)), int(rng.uniform(6, height - h - 6))
        image[y : y + h, x : x + w] = rng.choice([(40, 36, 34), (240, 240, 240)])
        image[y : y + 8, x : x + w] = random_color(rng)
        for row in range(y + 13, y + h - 8, 9):
            write_text(
                image, rng, x + 4, row, (w - 8) * rng.uniform(0.2, 0.95), 6, random_color(rng, (0.2, 0.8), (0.45, 0.6))
            )
    cv2.rectangle(image, (0, 0), (width - 1, height - 1), (20, 20, 20), 11)
    return image


def outdoors(rng: Rng, height: int, width: int) -> ByteArray:
    """Image (H, W, 3) BGR of a view through a window: sky, houses, trees."""
    sky = (
        np.array(color(0.58, 0.3, 1.0), np.float32)
        * (1 + 0.06 * noise(rng, height, width, height / 5, width / 4))[..., None]
    )
    image = np.clip(sky, 0, 255).astype(np.uint8)
    for _ in range(7):
        w, h = int(width * rng.uniform(0.1, 0.3)), int(height * rng.uniform(0.2, 0.55))
        x = int(rng.uniform(-w / 2, width - w / 2))
        image[height - h :, max(x, 0) : x + w] = random_color(rng, (0.05, 0.4), (0.4, 0.8))
        for row in range(height - h + 8, height - 8, 22):
            for column in range(max(x, 0) + 6, min(x + w, width) - 10, 20):
                image[row : row + 11, column : column + 8] = color(0.6, 0.3, rng.uniform(0.15, 0.6))
    crowns = noise(rng, height, width, 26, 26) + 5 * (np.arange(height)[:, None] / height - 0.72) * 2
    image[crowns > 0.9] = color(0.3, 0.5, 0.35)
    leaves = (crowns > 0.9) & (noise(rng, height, width, 5, 5) > 0.3)
    image[leaves] = color(0.27, 0.55, 0.55)
    return image

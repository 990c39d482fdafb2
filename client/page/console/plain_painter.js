// Surfaces, points and lines drawn by the processor, pixel by pixel. Where there is no graphics card, browsers work WebGL out in
// software, at some 10 µs a point; this takes some 0.05 µs.

const NEAR = 1e-3; // the least depth that is drawn, in the map's unit
const POINT_PX = [1, 6];

/** Paints on a canvas as `GlPainter` does, with the same methods. */
export class PlainPainter {
  constructor(canvas) {
    this.canvas = canvas;
    this.context = canvas.getContext("2d", { alpha: false });
    this.lines = new Map();
    this.surface = { positions: new Float32Array(0), tints: new Uint32Array(0), triangles: new Uint32Array(0) };
    this.positions = new Float32Array(0);
    this.colours = new Uint32Array(0);
  }

  setPoints(positions, tints) {
    this.positions = positions;
    this.colours = packedAll(tints);
  }

  setSurface(positions, tints, triangles) {
    this.surface = { positions, tints: packedAll(tints), triangles };
  }

  setLines(name, vertices) {
    if (vertices.length) this.lines.set(name, vertices);
    else this.lines.delete(name);
  }

  paint({ matrix, background, surface, count, size, styles }) {
    const [red, green, blue] = background.map((value) => Math.round(255 * value));
    this.begin(packed(red, green, blue));
    if (surface) this.drawSurface(matrix);
    this.drawPoints(matrix, count, size);
    for (const [name, colour] of styles) {
      const vertices = this.lines.get(name);
      if (vertices) this.drawLines(matrix, vertices, colour);
    }
    this.context.putImageData(this.image, 0, 0);
  }

  dispose() {}

  begin(background) {
    const { width, height } = this.canvas;
    if (this.image?.width !== width || this.image.height !== height) {
      this.image = this.context.createImageData(width, height);
      this.pixels = new Uint32Array(this.image.data.buffer);
      this.nearness = new Float32Array(width * height); // one over the depth of what is drawn, 0 where nothing is
    }
    this.pixels.fill(background);
    this.nearness.fill(0);
  }

  /** Triangles, those that turn away or reach behind the eye left out. */
  drawSurface(matrix) {
    const { positions, tints, triangles } = this.surface;
    const { width, height } = this.canvas;
    const [xs, ys, nears] = [0, 1, 2].map(() => new Float32Array(positions.length / 3));
    for (let i = 0; i < nears.length; i++) {
      const [x, y, w] = clip(matrix, positions, 3 * i);
      nears[i] = w > NEAR ? 1 / w : 0;
      xs[i] = (x * nears[i] + 1) * 0.5 * width;
      ys[i] = (1 - y * nears[i]) * 0.5 * height;
    }
    for (let i = 0; i < triangles.length; i += 3) {
      const [a, b, c] = [triangles[i], triangles[i + 1], triangles[i + 2]];
      const area = (xs[b] - xs[a]) * (ys[c] - ys[a]) - (xs[c] - xs[a]) * (ys[b] - ys[a]);
      if (area < 0 && nears[a] && nears[b] && nears[c]) this.drawTriangle(xs, ys, nears, [a, b, c], area, tints);
    }
  }

  drawTriangle(xs, ys, nears, [a, b, c], area, tints) {
    const { pixels, nearness } = this;
    const { width, height } = this.canvas;
    const [left, right] = [Math.min(xs[a], xs[b], xs[c]), Math.max(xs[a], xs[b], xs[c])];
    const [top, bottom] = [Math.min(ys[a], ys[b], ys[c]), Math.max(ys[a], ys[b], ys[c])];
    const [firstX, lastX] = [Math.max(0, Math.ceil(left - 0.5)), Math.min(width - 1, Math.floor(right - 0.5))];
    const [firstY, lastY] = [Math.max(0, Math.ceil(top - 0.5)), Math.min(height - 1, Math.floor(bottom - 0.5))];
    for (let row = firstY; row <= lastY; row++) {
      for (let column = firstX; column <= lastX; column++) {
        const [x, y] = [column + 0.5, row + 0.5];
        const u = ((xs[b] - x) * (ys[c] - y) - (xs[c] - x) * (ys[b] - y)) / area;
        const v = ((xs[c] - x) * (ys[a] - y) - (xs[a] - x) * (ys[c] - y)) / area;
        if (u < 0 || v < 0 || u + v > 1) continue;
        const near = u * nears[a] + v * nears[b] + (1 - u - v) * nears[c];
        const at = row * width + column;
        if (near <= nearness[at]) continue;
        nearness[at] = near;
        pixels[at] = mixed(tints[a], tints[b], tints[c], u, v);
      }
    }
  }

  drawPoints(matrix, count, size) {
    const { positions, colours, pixels, nearness } = this;
    const { width, height } = this.canvas;
    const [m0, m1, , m3, m4, m5, , m7, m8, m9, , m11, m12, m13, , m15] = matrix;
    for (let i = 0; i < count; i++) {
      const [x, y, z] = [positions[3 * i], positions[3 * i + 1], positions[3 * i + 2]];
      const depth = m3 * x + m7 * y + m11 * z + m15;
      if (depth < NEAR) continue;
      const near = 1 / depth;
      const wide = Math.max(POINT_PX[0], Math.min(POINT_PX[1], Math.round(size * near)));
      const left = Math.round(((m0 * x + m4 * y + m8 * z + m12) * near + 1) * 0.5 * width - wide / 2);
      const top = Math.round((1 - (m1 * x + m5 * y + m9 * z + m13) * near) * 0.5 * height - wide / 2);
      if (left < 0 || top < 0 || left + wide > width || top + wide > height) continue;
      for (let row = top; row < top + wide; row++) {
        for (let at = row * width + left, end = at + wide; at < end; at++) {
          if (near <= nearness[at]) continue;
          nearness[at] = near;
          pixels[at] = colours[i];
        }
      }
    }
  }

  drawLines(matrix, vertices, colour) {
    const { width, height } = this.canvas;
    /** @type {(vertex: number[]) => [number, number, number]} */
    const place = ([x, y, w]) => [(x / w + 1) * 0.5 * width, (1 - y / w) * 0.5 * height, 1 / w];
    for (let i = 0; i < vertices.length; i += 6) {
      const ends = clipped(clip(matrix, vertices, i), clip(matrix, vertices, i + 3));
      if (ends) this.drawLine(place(ends[0]), place(ends[1]), colour);
    }
  }

  /** A line between two places of the picture; one over the depth changes evenly along it. */
  drawLine([ax, ay, aNear], [bx, by, bNear], [red, green, blue, alpha]) {
    const { pixels, nearness } = this;
    const { width, height } = this.canvas;
    const steps = Math.max(1, Math.ceil(Math.max(Math.abs(bx - ax), Math.abs(by - ay))));
    const [r, g, b] = [red, green, blue].map((value) => 255 * value * alpha);
    const stays = 1 - alpha;
    for (let step = 0; step <= steps; step++) {
      const share = step / steps;
      const x = Math.min(width - 1, Math.floor(ax + share * (bx - ax)));
      const y = Math.min(height - 1, Math.floor(ay + share * (by - ay)));
      const near = aNear + share * (bNear - aNear);
      const at = y * width + x;
      if (near < nearness[at]) continue;
      nearness[at] = near;
      const below = pixels[at];
      pixels[at] = packed(
        r + stays * (below & 255),
        g + stays * ((below >> 8) & 255),
        b + stays * ((below >> 16) & 255),
      );
    }
  }
}

/** A pixel as image data has it, read as one little-endian number. */
const packed = (red, green, blue) => ((255 << 24) | (blue << 16) | (green << 8) | red) >>> 0;

/** The pixel between three, by the weights of the first two. */
function mixed(a, b, c, u, v) {
  const w = 1 - u - v;
  const part = (shift) => u * ((a >> shift) & 255) + v * ((b >> shift) & 255) + w * ((c >> shift) & 255);
  return packed(part(0), part(8), part(16));
}

/** Colours, three bytes each, as pixels. */
const packedAll = (tints) =>
  Uint32Array.from({ length: tints.length / 3 }, (_, i) => packed(tints[3 * i], tints[3 * i + 1], tints[3 * i + 2]));

/** A vertex in clip coordinates: x, y, w. */
function clip(matrix, vertices, i) {
  const [x, y, z] = [vertices[i], vertices[i + 1], vertices[i + 2]];
  return [0, 1, 3].map((row) => matrix[row] * x + matrix[4 + row] * y + matrix[8 + row] * z + matrix[12 + row]);
}

/**
 * What of a line, in clip coordinates, is in the picture: its ends, or null (Liang and Barsky, ACM Transactions on
 * Graphics 3, 1984).
 */
export function clipped(a, b) {
  const inside = ([x, y, w]) => [w - NEAR, w + x, w - x, w + y, w - y];
  const [from, to] = [inside(a), inside(b)];
  let [start, end] = [0, 1];
  for (let i = 0; i < from.length; i++) {
    const change = to[i] - from[i];
    if (from[i] < 0 && to[i] < 0) return null;
    if (from[i] < 0) start = Math.max(start, -from[i] / change);
    else if (to[i] < 0) end = Math.min(end, -from[i] / change);
  }
  if (start > end) return null;
  const at = (share) => a.map((value, i) => value + share * (b[i] - value));
  return [at(start), at(end)];
}

// Surfaces, points and lines drawn by the graphics card, with WebGL.

const POINT_SHADER = `
  attribute vec3 point; attribute vec3 tint; uniform mat4 matrix; uniform float size; varying vec3 colour;
  void main() {
    gl_Position = matrix * vec4(point, 1.0);
    gl_PointSize = clamp(size / gl_Position.w, 1.5, 12.0);
    colour = tint;
  }`;
const POINT_COLOUR = "precision mediump float; varying vec3 colour; void main() { gl_FragColor = vec4(colour, 1.0); }";
const LINE_SHADER =
  "attribute vec3 point; uniform mat4 matrix; void main() { gl_Position = matrix * vec4(point, 1.0); }";
const LINE_COLOUR = "precision mediump float; uniform vec4 colour; void main() { gl_FragColor = colour; }";

/** Paints on a canvas; throws where there is no WebGL. */
export class GlPainter {
  constructor(canvas) {
    this.gl = canvas.getContext("webgl", { alpha: false, antialias: false, powerPreference: "low-power" });
    if (!this.gl) throw new Error("no WebGL");
    this.canvas = canvas;
    this.points = program(this.gl, POINT_SHADER, POINT_COLOUR);
    this.strokes = program(this.gl, LINE_SHADER, LINE_COLOUR);
    this.lines = new Map();
    this.buffers = [this.gl.createBuffer(), this.gl.createBuffer()];
    this.surface = { buffers: [0, 1, 2].map(() => this.gl.createBuffer()), count: 0 };
    this.gl.getExtension("OES_element_index_uint");
    canvas.addEventListener("webglcontextlost", (event) => event.preventDefault());
    canvas.addEventListener("webglcontextrestored", () => location.reload());
  }

  /** What is drawn as points: (N, 3) positions as float32, (N, 3) red, green, blue as uint8. */
  setPoints(positions, tints) {
    fill(this.gl, this.buffers[0], positions);
    fill(this.gl, this.buffers[1], tints);
  }

  /** What is drawn as surfaces: (V, 3) positions, (V, 3) red, green, blue, and (3 T) vertices, anti-clockwise where seen. */
  setSurface(positions, tints, triangles) {
    const { gl, surface } = this;
    fill(gl, surface.buffers[0], positions);
    fill(gl, surface.buffers[1], tints);
    gl.bindBuffer(gl.ELEMENT_ARRAY_BUFFER, surface.buffers[2]);
    gl.bufferData(gl.ELEMENT_ARRAY_BUFFER, triangles, gl.STATIC_DRAW);
    surface.count = triangles.length;
  }

  /** The ends (2 N, 3) of lines, as float32; none end those of that name. */
  setLines(name, vertices) {
    const known = this.lines.get(name);
    if (!vertices.length) {
      if (known) this.gl.deleteBuffer(known.buffer);
      this.lines.delete(name);
      return;
    }
    const buffer = known?.buffer ?? this.gl.createBuffer();
    fill(this.gl, buffer, vertices);
    this.lines.set(name, { buffer, count: vertices.length / 3 });
  }

  /**
   * Draw the surfaces if `surface`, the first `count` points, `size` pixels wide at a distance of one, and the lines in
   * the order of `styles`, which are `[name, [red, green, blue, alpha]]`; colours from 0 to 1.
   */
  paint({ matrix, background, surface, count, size, styles }) {
    const { gl, points, strokes, canvas } = this;
    gl.viewport(0, 0, canvas.width, canvas.height);
    gl.clearColor(...background, 1);
    gl.clear(gl.COLOR_BUFFER_BIT | gl.DEPTH_BUFFER_BIT);
    gl.enable(gl.DEPTH_TEST);
    if (surface && this.surface.count) {
      gl.enable(gl.CULL_FACE);
      gl.useProgram(points.program);
      gl.uniformMatrix4fv(points.uniform("matrix"), false, matrix);
      attribute(gl, 0, this.surface.buffers[0], gl.FLOAT);
      attribute(gl, 1, this.surface.buffers[1], gl.UNSIGNED_BYTE);
      gl.bindBuffer(gl.ELEMENT_ARRAY_BUFFER, this.surface.buffers[2]);
      gl.drawElements(gl.TRIANGLES, this.surface.count, gl.UNSIGNED_INT, 0);
      gl.disable(gl.CULL_FACE);
    }
    if (count) {
      gl.useProgram(points.program);
      gl.uniformMatrix4fv(points.uniform("matrix"), false, matrix);
      gl.uniform1f(points.uniform("size"), size);
      attribute(gl, 0, this.buffers[0], gl.FLOAT);
      attribute(gl, 1, this.buffers[1], gl.UNSIGNED_BYTE);
      gl.drawArrays(gl.POINTS, 0, count);
    }
    gl.enable(gl.BLEND);
    gl.blendFunc(gl.SRC_ALPHA, gl.ONE_MINUS_SRC_ALPHA);
    gl.disableVertexAttribArray(1);
    gl.useProgram(strokes.program);
    gl.uniformMatrix4fv(strokes.uniform("matrix"), false, matrix);
    for (const [name, colour] of styles) {
      const line = this.lines.get(name);
      if (!line) continue;
      gl.uniform4f(strokes.uniform("colour"), ...colour);
      attribute(gl, 0, line.buffer, gl.FLOAT);
      gl.drawArrays(gl.LINES, 0, line.count);
    }
    gl.disable(gl.BLEND);
  }

  dispose() {
    this.gl.getExtension("WEBGL_lose_context")?.loseContext();
  }
}

function fill(gl, buffer, numbers) {
  gl.bindBuffer(gl.ARRAY_BUFFER, buffer);
  gl.bufferData(gl.ARRAY_BUFFER, numbers, gl.STATIC_DRAW);
}

/** Take an attribute of three numbers from a buffer. */
function attribute(gl, place, buffer, type) {
  gl.bindBuffer(gl.ARRAY_BUFFER, buffer);
  gl.enableVertexAttribArray(place);
  gl.vertexAttribPointer(place, 3, type, type === gl.UNSIGNED_BYTE, 0, 0);
}

function program(gl, ...sources) {
  const made = gl.createProgram();
  sources.forEach((source, i) => {
    const shader = gl.createShader(i ? gl.FRAGMENT_SHADER : gl.VERTEX_SHADER);
    gl.shaderSource(shader, source);
    gl.compileShader(shader);
    gl.attachShader(made, shader);
  });
  gl.bindAttribLocation(made, 0, "point");
  gl.bindAttribLocation(made, 1, "tint");
  gl.linkProgram(made);
  const places = {};
  return { program: made, uniform: (name) => (places[name] ??= gl.getUniformLocation(made, name)) };
}

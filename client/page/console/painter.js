// What paints a map in 3-D: the graphics card where there is one, else the processor.

import { GlPainter } from "./gl_painter.js";
import { PlainPainter } from "./plain_painter.js";

const IN_SOFTWARE = /swiftshader|llvmpipe|softpipe|software|basic render/i;

/** The quicker of the two on this device. */
export function painterOf(canvas) {
  if (hasGraphicsCard()) return new GlPainter(canvas);
  return new PlainPainter(canvas);
}

/** Whether WebGL is there, and not worked out by the processor. */
function hasGraphicsCard() {
  const gl = document.createElement("canvas").getContext("webgl", { failIfMajorPerformanceCaveat: true });
  if (!gl) return false;
  const info = gl.getExtension("WEBGL_debug_renderer_info");
  const name = String(gl.getParameter(info ? info.UNMASKED_RENDERER_WEBGL : gl.RENDERER));
  gl.getExtension("WEBGL_lose_context")?.loseContext();
  return !IN_SOFTWARE.test(name);
}

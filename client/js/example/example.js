// A named point of a map, drawn into the camera's picture: by WebXR where the browser has it, else by the answers
// themselves, turned between them as the phone's gyroscope says.

import { Axes, Client, cameraOfProjection, carried, inverse, MapSession, multiply } from "../index.js";

const { navigator: device, XRWebGLBinding, XRWebGLLayer, DeviceOrientationEvent } = /** @type {any} */ (globalThis);
const EVERY_MS = 700;
const SENT_PX = 640; // of a picture's longer side
const QUALITY = 0.8;

const [form, said, view, marker, video] = ["#start", "#said", "#view", "#marker", "video"].map(
  (one) => /** @type {any} */ (document.querySelector(one)),
);
for (const [name, value] of new URLSearchParams(location.search))
  if (form.elements[name]) form.elements[name].value = value;

form.addEventListener("submit", async (event) => {
  event.preventDefault();
  const { service, map, point, key } = Object.fromEntries([...form.elements].map((one) => [one.name, one.value]));
  try {
    const rholoc = new Client(service, { key });
    const { points } = (await rholoc.map(map)).names;
    const chosen = points.find(({ name }) => name === point) ?? points[0];
    if (!chosen) throw new Error(`The map ${map} has no named point.`);
    marker.textContent = chosen.name;
    form.hidden = true;
    const xr = await device.xr?.isSessionSupported("immersive-ar");
    await (xr ? followByWebXR : followByAnswers)(rholoc, map, chosen.position);
  } catch (error) {
    form.hidden = false;
    say(error.message);
  }
});

/** The camera's stream; the pose is that of the last answer, turned by the gyroscope since its picture. */
async function followByAnswers(rholoc, map, point) {
  await DeviceOrientationEvent?.requestPermission?.();
  let turn = null; // R_earth_device
  addEventListener("deviceorientation", ({ alpha, beta, gamma }) => {
    if (alpha !== null) turn = orientation(alpha, beta, gamma);
  });
  video.srcObject = await navigator.mediaDevices.getUserMedia({ video: { facingMode: "environment" } });
  await video.play();
  let found = null; // of the last answer: pose, camera, and the orientation at its picture
  const draw = () => {
    show(found && projected(point, multiply(found.T_map_camera, since(found.turn, turn)), found.camera));
    requestAnimationFrame(draw);
  };
  requestAnimationFrame(draw);
  for (;;) {
    const [before, began] = [turn, performance.now()];
    const { image, width, height } = await picture();
    const options = /** @type {const} */ ({ intrinsics: "unknown", camera: { width, height } });
    const answer = await rholoc.localize(map, image, options).catch((error) => {
      say(error.message);
      if (!error.passes) throw error;
    });
    if (answer?.localized) {
      found = { T_map_camera: answer.pose.T_map_camera, camera: answer.camera, turn: before };
      say(`Here, to ${Math.sqrt(answer.covariance[0][0]).toFixed(2)} m.`);
    } else if (answer) {
      found = null; // nothing rather than something wrong
      say(`${answer.diagnosis.message} ${answer.diagnosis.hint}`);
    }
    await new Promise((resolve) => setTimeout(resolve, Math.max(0, EVERY_MS - (performance.now() - began))));
  }
}

/** The session of WebXR says how the camera moves, its raw pictures are asked about. */
async function followByWebXR(rholoc, map, point) {
  const session = await device.xr.requestSession("immersive-ar", {
    requiredFeatures: ["camera-access", "dom-overlay"],
    domOverlay: { root: document.body },
  });
  const gl = /** @type {any} */ (document.createElement("canvas").getContext("webgl2", { xrCompatible: true }));
  const binding = new XRWebGLBinding(session, gl);
  session.updateRenderState({ baseLayer: new XRWebGLLayer(session, gl) });
  const space = await session.requestReferenceSpace("local");
  const place = new MapSession((image, options) => rholoc.localize(map, image, options), {
    axes: Axes.OPENGL,
    onLocalized: () => say("Here."),
    onLost: () => say("Lost: look around."),
    onError: (error) => say(error.message),
  });
  video.hidden = true;
  view.style.height = "100vh";
  const frame = (_, xrFrame) => {
    session.requestAnimationFrame(frame);
    gl.bindFramebuffer(gl.FRAMEBUFFER, session.renderState.baseLayer.framebuffer);
    gl.clear(gl.COLOR_BUFFER_BIT);
    const [eye] = xrFrame.getViewerPose(space)?.views ?? [];
    if (!eye?.camera) return;
    const { width, height } = eye.camera;
    const camera = cameraOfProjection(eye.projectionMatrix, width, height);
    // Only within this call the picture is of this pose, so it is read at once if it may be asked about.
    place.offer({
      pose: eye.transform.matrix,
      picture: () => read(gl, binding.getCameraImage(eye.camera), camera),
      camera,
    });
    const T_map_camera = place.inMap(eye.transform.matrix);
    show(T_map_camera && projected(point, T_map_camera, camera));
  };
  session.requestAnimationFrame(frame);
}

/** A texture of WebGL, whose rows begin at the bottom, as JPEG. */
function read(gl, texture, { width, height }) {
  const buffer = gl.createFramebuffer();
  const pixels = new Uint8ClampedArray(4 * width * height);
  gl.bindFramebuffer(gl.FRAMEBUFFER, buffer);
  gl.framebufferTexture2D(gl.FRAMEBUFFER, gl.COLOR_ATTACHMENT0, gl.TEXTURE_2D, texture, 0);
  gl.readPixels(0, 0, width, height, gl.RGBA, gl.UNSIGNED_BYTE, pixels);
  gl.deleteFramebuffer(buffer);
  const canvas = new OffscreenCanvas(width, height);
  const context = canvas.getContext("2d");
  const flipped = new ImageData(width, height);
  for (let row = 0; row < height; row++)
    flipped.data.set(pixels.subarray(4 * width * row, 4 * width * (row + 1)), 4 * width * (height - 1 - row));
  context.putImageData(flipped, 0, 0);
  return canvas.convertToBlob({ type: "image/jpeg", quality: QUALITY });
}

/** The video's picture as it is now, made smaller. */
async function picture() {
  const scale = Math.min(1, SENT_PX / Math.max(video.videoWidth, video.videoHeight));
  const [width, height] = [video.videoWidth, video.videoHeight].map((length) => Math.round(scale * length));
  const canvas = new OffscreenCanvas(width, height);
  canvas.getContext("2d").drawImage(video, 0, 0, width, height);
  return { image: await canvas.convertToBlob({ type: "image/jpeg", quality: QUALITY }), width, height };
}

/** Where a point of the map is in the picture, in shares of its width and height; null behind the camera. */
function projected(point, T_map_camera, { fx, fy, cx, cy, width, height }) {
  const [x, y, z] = carried(inverse(T_map_camera), point);
  return z > 0.05 ? [((fx * x) / z + cx + 0.5) / width, ((fy * y) / z + cy + 0.5) / height] : null;
}

function show(place) {
  marker.hidden = place === null;
  if (place) Object.assign(marker.style, { left: `${100 * place[0]}%`, top: `${100 * place[1]}%` });
}

/** R_earth_device of the angles of `deviceorientation`, as four rows. */
function orientation(alpha, beta, gamma) {
  const [a, b, c] = [alpha, beta, gamma].map((angle) => (angle * Math.PI) / 180);
  const about = (i, j, angle) => {
    const R = [0, 1, 2, 3].map((row) => [0, 1, 2, 3].map((column) => Number(row === column)));
    R[i][i] = R[j][j] = Math.cos(angle);
    R[j][i] = Math.sin(angle);
    R[i][j] = -R[j][i];
    return R;
  };
  return multiply(multiply(about(0, 1, a), about(1, 2, b)), about(2, 0, c));
}

/** T_before_now of the camera by two orientations of the device, held upright: its camera looks along −z, with y up. */
function since(before, now) {
  const still = [0, 1, 2, 3].map((i) => [0, 1, 2, 3].map((j) => Number(i === j)));
  if (!before || !now) return still;
  const flip = [1, -1, -1, 1];
  return multiply(inverse(before), now).map((row, i) => row.map((value, j) => flip[i] * value * flip[j]));
}

function say(text) {
  said.textContent = text;
}

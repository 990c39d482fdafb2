// Try it: a picture, a camera or a trajectory, and where it is in the map.

import { call, get, path } from "../shared/api.js";
import { fill, h } from "../shared/dom.js";
import { length } from "./format.js";
import { showScene } from "./map.js";
import { empty, facts, field, page, problem } from "./parts.js";
import { SceneView } from "./scene.js";
import { readTrajectory } from "./trajectory.js";

const WHY = {
  no_features: "The picture is too blank, dark or blurred.",
  no_matches: "Too little in the picture looks like anything in the map.",
  no_agreement: "No place explains what the picture shows.",
  low_confidence: "A place was found, but it is too unsure to rely on.",
  deadline: "The server took too long.",
};
const CAMERA_WIDTH = 640; // px, of frames from this device's camera
const JPEG_QUALITY = 0.85;
const RATE_OVER = 8; // frames that the rate is told over
const PRIOR_RADIUS_M = 1;
const OWN_CAMERA = "";
const FIELD_OF_VIEW = " fov"; // no camera has a name with a space

export async function showTry(main, name, signal) {
  const { maps } = await get("v1/maps", { signal });
  if (!maps.length) {
    fill(
      main,
      empty(
        "No map to try",
        "Make one of a walk first.",
        h("a", { class: "button primary", href: "record" }, "Record a walk"),
      ),
    );
    return;
  }
  const { cameras } = await get("v1/cameras", { signal });
  const map = await get(path`v1/maps/${name ?? maps[0].name}`, { signal });
  const trial = new Trial(map, signal);
  fill(main, layout(trial, maps, cameras));
  await showScene(trial.scene, map, signal);
}

/** What is tried in one map, and how it is shown. */
class Trial {
  constructor(map, signal) {
    Object.assign(this, { map, signal, ends: [] });
    this.scene = new SceneView(`The map ${map.name} and the pose that was found`);
    this.picture = h("canvas", {
      class: "frame",
      width: 640,
      height: 480,
      role: "img",
      "aria-label": "No picture yet",
    });
    this.answer = h("div", { class: "answer", role: "status" }, h("p", { class: "muted" }, "The pose appears here."));
    this.intrinsics = h("select", { name: "camera" });
    this.degrees = h("input", { type: "number", min: 20, max: 150, step: "any", value: 65 });
    this.rolls = h("input", { type: "checkbox", checked: true });
    signal.addEventListener("abort", () => {
      this.stop();
      this.scene.dispose();
    });
  }

  /** End the camera or the playing, whichever runs. */
  stop() {
    for (const end of this.ends.splice(0)) end();
  }

  /** Localize one picture (a canvas, an image or a video of a size) and show where it is. */
  async localize(blob, source, prior) {
    const query = { ...this.options(source.width), ...prior, dof: this.rolls.checked ? "auto" : 5, with_matches: true };
    const found = await call("POST", path`v1/maps/${this.map.name}/localize`, {
      body: blob,
      headers: { "Content-Type": blob.type },
      query,
      signal: this.signal,
    });
    this.draw(source, found);
    this.scene.showPose(found.pose?.T_map_camera ?? null, found.localized ? found.agreeing.landmarks : []);
    return found;
  }

  options(width) {
    if (this.intrinsics.value === FIELD_OF_VIEW) {
      return { fx: (width / 2 / Math.tan((this.degrees.value * Math.PI) / 360)).toFixed(2) };
    }
    return { camera: this.intrinsics.value };
  }

  /** The picture, and on it the features that the map recognised. */
  draw(source, found) {
    const { picture } = this;
    Object.assign(picture, { width: source.width, height: source.height });
    const context = picture.getContext("2d");
    context.drawImage(source.image, 0, 0, source.width, source.height);
    const radius = Math.max(3, source.width / 160);
    context.lineWidth = radius / 2.5;
    context.strokeStyle = found.localized ? "#35e0a1" : "#ffb454";
    for (const [u, v] of found.agreeing.pixels) {
      context.beginPath();
      context.arc(u, v, radius, 0, 2 * Math.PI);
      context.stroke();
    }
    picture.setAttribute(
      "aria-label",
      found.localized
        ? `The picture with ${found.inliers} features that the map recognised`
        : "The picture; it has no pose",
    );
  }

  tell(found, extra) {
    const { pose, confidence } = found;
    const metric = found.scale === "metric";
    const sigma =
      found.covariance && Math.sqrt((found.covariance[0][0] + found.covariance[1][1] + found.covariance[2][2]) / 3);
    fill(
      this.answer,
      h(
        "div",
        { class: "row" },
        h("span", { class: ["badge", found.localized ? "good" : "warn"] }, found.localized ? "localized" : "no pose"),
        h(
          "label",
          { class: "confidence" },
          `confidence ${Math.round(100 * confidence)} %`,
          h("meter", { min: 0, max: 1, low: 0.5, high: 0.8, optimum: 1, value: confidence }),
        ),
      ),
      !found.localized && h("p", {}, WHY[found.reason] ?? found.reason),
      facts([
        [
          "Position",
          pose ? pose.position.map((value) => value.toFixed(2)).join(", ") + (metric ? " m" : " units") : "–",
        ],
        ["Heading", pose ? pose.heading.map((value) => value.toFixed(2)).join(", ") : "–"],
        ["Off by about", sigma ? length(sigma, metric) : "–"],
        ["Matches", `${found.inliers} of ${found.matches} agree`],
        ["Took", `${found.timings_ms.total.toFixed(0)} ms${extra ? `, ${extra}` : ""}`],
      ]),
    );
  }

  fail(error) {
    if (this.signal.aborted) return;
    const mismatch = error.code === "invalid_camera";
    const hint = mismatch ? "Choose a stored camera, or the field of view." : error.hint;
    fill(this.answer, problem({ summary: error.summary ?? error.message, hint }));
  }
}

function layout(trial, maps, cameras) {
  const choice = h(
    "select",
    { onchange: () => (location.hash = `#/try/${encodeURIComponent(choice.value)}`) },
    maps.map(({ name }) => h("option", { selected: name === trial.map.name }, name)),
  );
  const degrees = field("Horizontal field of view, °", trial.degrees);
  degrees.hidden = true;
  fill(
    trial.intrinsics,
    h("option", { value: OWN_CAMERA }, "the map's own camera"),
    cameras.map(({ name }) => h("option", { value: name }, name)),
    h("option", { value: FIELD_OF_VIEW }, "by its field of view"),
  );
  trial.intrinsics.addEventListener("change", () => (degrees.hidden = trial.intrinsics.value !== FIELD_OF_VIEW));
  return page(
    "Try it",
    field("Map", choice),
    h(
      "div",
      { class: "try-columns" },
      h("div", { class: "stack" }, dropZone(trial), sources(trial)),
      h("div", { class: "stack" }, trial.scene.element, trial.answer),
    ),
    h(
      "details",
      { class: "card" },
      h("summary", {}, "Camera options"),
      h(
        "div",
        { class: "form" },
        field("Intrinsics", trial.intrinsics),
        degrees,
        h("label", { class: "check" }, trial.rolls, "hand-held: the camera may roll"),
      ),
    ),
  );
}

function dropZone(trial) {
  const zone = h(
    "div",
    { class: "drop" },
    trial.picture,
    h("p", { class: "drop-hint muted" }, "Drop a picture or a trajectory (CSV) here"),
  );
  zone.addEventListener("dragover", (event) => {
    event.preventDefault();
    zone.classList.add("over");
  });
  zone.addEventListener("dragleave", () => zone.classList.remove("over"));
  zone.addEventListener("drop", (event) => {
    event.preventDefault();
    zone.classList.remove("over");
    if (event.dataTransfer.files.length) takeFile(trial, event.dataTransfer.files[0]);
  });
  return zone;
}

function sources(trial) {
  const input = h("input", {
    type: "file",
    accept: "image/*,.csv",
    class: "visually-hidden",
    "aria-label": "Picture or trajectory",
    onchange: () => {
      if (input.files.length) takeFile(trial, input.files[0]);
      input.value = "";
    },
  });
  trial.player = h("div", { class: "row", hidden: true });
  trial.cameraButton = h(
    "button",
    { type: "button", onclick: () => (trial.ends.length ? trial.stop() : filmOrSay(trial)) },
    "Use the camera",
  );
  return h(
    "div",
    { class: "stack" },
    h("div", { class: "row" }, h("label", { class: "button file" }, "Choose a file", input), trial.cameraButton),
    trial.player,
  );
}

async function takeFile(trial, file) {
  trial.stop();
  trial.picture.closest(".drop").classList.add("taken");
  try {
    if (/\.csv$/i.test(file.name)) play(trial, readTrajectory(await file.text()));
    else await takePicture(trial, file);
  } catch (error) {
    trial.fail(error);
  }
}

async function takePicture(trial, file) {
  let image;
  try {
    image = await createImageBitmap(file);
  } catch {
    throw new Error("This file is not a picture that the browser can read.");
  }
  const source = { image, width: image.width, height: image.height };
  const sent = /^image\/(jpeg|png)$/.test(file.type) ? file : await jpeg(source);
  fill(trial.answer, h("p", { class: "muted" }, "Localizing …"));
  trial.tell(await trial.localize(sent, source, {}));
}

function jpeg({ image, width, height }, canvas = h("canvas", { width, height })) {
  canvas.getContext("2d").drawImage(image, 0, 0, width, height);
  return new Promise((resolve) => canvas.toBlob(resolve, "image/jpeg", JPEG_QUALITY));
}

async function filmOrSay(trial) {
  try {
    await film(trial);
  } catch (error) {
    trial.fail(error);
    trial.stop();
  }
}

/** Localize what this device's camera sees, one frame after the other, the last pose being the next one's prior. */
async function film(trial) {
  if (!navigator.mediaDevices) throw new Error("The camera needs HTTPS: start the server with rholoc serve --tls.");
  let stream;
  try {
    stream = await navigator.mediaDevices.getUserMedia({
      video: { width: { ideal: CAMERA_WIDTH }, facingMode: "environment" },
    });
  } catch (error) {
    const refused = error.name === "NotAllowedError";
    throw new Error(
      refused ? "The camera was refused. Allow it in the browser's settings for this page." : "No camera was found.",
    );
  }
  const video = h("video", { playsinline: true, muted: true });
  let filming = true;
  trial.cameraButton.textContent = "Stop the camera";
  trial.ends.push(() => {
    filming = false;
    for (const track of stream.getTracks()) track.stop();
    trial.cameraButton.textContent = "Use the camera";
  });
  video.srcObject = stream;
  video.muted = true;
  await video.play();
  trial.picture.closest(".drop").classList.add("taken");
  const canvas = h("canvas");
  const times = [];
  let prior = {};
  while (filming && !trial.signal.aborted) {
    const [width, height] = [CAMERA_WIDTH, Math.round((CAMERA_WIDTH * video.videoHeight) / video.videoWidth)];
    Object.assign(canvas, { width, height });
    const blob = await jpeg({ image: video, width, height }, canvas);
    const found = await trial.localize(blob, { image: canvas, width, height }, prior);
    prior = found.localized ? priorOf(found.pose) : {};
    times.push(performance.now());
    if (times.length > RATE_OVER) times.shift();
    const rate = times.length > 1 ? (1000 * (times.length - 1)) / (times.at(-1) - times[0]) : 0;
    trial.tell(found, `${rate.toFixed(1)} frames a second`);
    await new Promise(requestAnimationFrame); // draws, and lets a tab in the background rest
  }
}

function priorOf({ position, heading }) {
  return { prior_position: position.join(","), prior_heading: heading.join(","), prior_radius_m: PRIOR_RADIUS_M };
}

/** Play a trajectory in the map: its path as a line, the camera moving along it in its own time. */
function play(trial, poses) {
  const [first, last] = [poses[0].time, poses.at(-1).time];
  const slider = h("input", { type: "range", min: first, max: last, step: "any", value: first, "aria-label": "Time" });
  const clock = h("span", { class: "mono" });
  const button = h("button", { type: "button" }, "Pause");
  let running = true;
  let since = performance.now();
  const show = () => {
    const time = Number(slider.value);
    const at = Math.max(
      0,
      poses.findLastIndex((pose) => pose.time <= time),
    );
    clock.textContent = `${(time - first).toFixed(1)} s`;
    trial.scene.showPose(poses[at].T);
  };
  const step = (now) => {
    if (!running) return;
    slider.value = Math.min(last, Number(slider.value) + (now - since) / 1000);
    since = now;
    show();
    if (Number(slider.value) >= last) pause();
    else requestAnimationFrame(step);
  };
  const pause = () => {
    running = false;
    button.textContent = "Play";
  };
  const start = () => {
    if (Number(slider.value) >= last) slider.value = first;
    running = true;
    since = performance.now();
    button.textContent = "Pause";
    requestAnimationFrame(step);
  };
  button.addEventListener("click", () => (running ? pause() : start()));
  slider.addEventListener("input", show);
  trial.ends.push(() => {
    pause();
    trial.player.hidden = true;
    trial.scene.showTrail([]);
  });
  trial.scene.showTrail(poses.map(({ position }) => position));
  fill(trial.player, button, slider, clock);
  trial.player.hidden = false;
  fill(
    trial.answer,
    facts([
      ["Trajectory", `${poses.length} poses`],
      ["Lasts", `${(last - first).toFixed(1)} s`],
    ]),
  );
  start();
}

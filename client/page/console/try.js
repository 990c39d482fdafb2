// Try it: a picture, a camera, a video or a trajectory, and where it is in the map.

import { path, rholoc, storedKey } from "../shared/api.js";
import { action, fill, h, tell } from "../shared/dom.js";
import { field } from "../shared/name_choice.js";
import { coordinates, decimal, heard, t } from "../shared/text.js";
import { inPlainWords, mostTrusted, Trust, trustOf, whatToDo } from "../shared/trust.js";
import { length } from "./format.js";
import { cameraFrames, readPicture, videoFrames } from "./frame_sources.js";
import { asQuery, halfExtents, intrinsicsFor, intrinsicsOfFieldOfView, Known } from "./intrinsics.js";
import { landscapeView } from "./landscape_view.js";
import { showScene, trusted } from "./map.js";
import { empty, facts, goOn, page, problem, trustBadge } from "./parts.js";
import { play } from "./player.js";
import { SceneView } from "./scene.js";
import { LANGUAGES, snippet } from "./snippets.js";
import { Track, trackReport } from "./track.js";
import { readTrajectory } from "./trajectory.js";

const RATE_OVER = 8; // frames that the rate is measured over
const PRIOR_RADIUS_M = 1;
const TRACK_MS = 66; // from one frame that is tracked to the next, at least: more are no better
const AUTOMATIC = "";
const MAP_CAMERA = " map"; // no camera has a name with a space
const UNKNOWN = " unknown";
const FIELD_OF_VIEW = " fov";
const HIGHEST_SHOWN_CONFIDENCE = 0.99; // above it the page says “over 99 %”: nothing is certain

export async function showTry(main, name, signal) {
  const { maps } = await rholoc.get("v1/maps", { signal });
  if (!maps.length) {
    fill(
      main,
      empty(
        t`No map to try`,
        t`Make one of a walk first.`,
        h("a", { class: "button primary", href: "record" }, t`Record a walk`),
      ),
    );
    return;
  }
  const { cameras } = await rholoc.get("v1/cameras", { signal });
  const map = await rholoc.get(path`v1/maps/${name ?? mostTrusted(maps).name}`, { signal });
  const trial = new Trial(map, cameras, maps.length > 1, signal);
  fill(main, layout(trial, maps));
  await showScene(trial.scene, map, signal);
}

/** What is tried in one map, and how it is shown. */
class Trial {
  #asked = 0; // the number of the newest question; answers to older ones are not shown
  #question = new AbortController();

  constructor(map, cameras, several, signal) {
    this.map = map;
    this.several = several; // whether there are other maps
    this.cameras = cameras;
    this.signal = signal;
    this.ends = []; // of what runs; each ends it
    this.filming = false;
    this.scene = new SceneView(t`The map ${map.name} and the pose that was found`);
    this.picture = h("canvas", {
      class: "frame",
      width: 640,
      height: 480,
      role: "img",
      "aria-label": t`No picture yet`,
    });
    this.answer = h("div", { class: "answer", role: "status" }, h("p", { class: "muted" }, t`The pose appears here.`));
    this.intrinsics = h("select", { name: "camera" });
    this.degrees = h("input", { type: "number", min: 20, max: 150, step: "any", placeholder: t`such as 65` });
    this.rolls = h("input", { type: "checkbox", checked: true });
    const metric = map.scale === "metric"; // a track needs a scale
    this.tracks = h("input", { type: "checkbox", checked: metric, disabled: !metric });
    this.copying = h("div", { class: "copy stack", hidden: true });
    this.landscape = h("div", { class: "stack" });
    this.elsewhere = h("div", { class: "stack", role: "status" });
    this.still = null; // the picture that is tried, unless a camera runs
    signal.addEventListener("abort", () => {
      this.stop();
      this.scene.dispose();
    });
  }

  /** End the camera or the playing, whichever runs. */
  stop() {
    for (const end of this.ends.splice(0)) end();
  }

  /** Try a picture, and again whenever the options change. */
  async tryStill(still) {
    this.still = still;
    this.show(still.source);
    fill(this.answer, h("p", { class: "muted" }, t`Localizing …`));
    fill(this.landscape);
    fill(this.elsewhere);
    await this.localize(still.blob, still.source, {});
    if (this.still !== still) return;
    fill(this.landscape, this.offerLandscape(still));
    if (this.several) fill(this.elsewhere, this.offerAllMaps(still));
  }

  /** A button that tries all maps, and shows the most confident answer in its own place. */
  offerAllMaps({ blob, source }) {
    return action(t`Try all maps`, async () => {
      const number = this.#asked;
      const { query, known } = this.intrinsicsOf(source.width, source.height);
      const found = await rholoc.call("POST", "v1/localize", {
        body: blob,
        query: { ...this.queryOf({ query }), maps: "all" },
        signal: AbortSignal.any([this.signal, this.#question.signal]),
      });
      if (number !== this.#asked) return;
      const link = h("a", { href: `#/try/${encodeURIComponent(found.map)}` }, found.map);
      fill(
        this.elsewhere,
        found.localized
          ? h("p", { class: "row" }, t`Most confident of all maps:`, link, confidenceOf(found, known))
          : h("p", {}, t`No map localizes this picture.`),
      );
    });
  }

  /** A button that shows the landscape around the answer's pose in its own place. */
  offerLandscape({ blob, source }) {
    return action(t`Show the landscape around the pose`, async () => {
      const number = this.#asked;
      const seen = await rholoc.call("POST", path`v1/maps/${this.map.name}/landscape`, {
        body: blob,
        query: this.queryOf(this.intrinsicsOf(source.width, source.height)),
        signal: AbortSignal.any([this.signal, this.#question.signal]),
      });
      if (number === this.#asked) fill(this.landscape, landscapeView(seen, this.signal));
    });
  }

  queryOf(intrinsics) {
    return { ...intrinsics.query, dof: this.rolls.checked ? "auto" : 5 };
  }

  async again() {
    if (!this.still) return;
    try {
      await this.tryStill(this.still);
    } catch (error) {
      this.fail(error, () => this.again());
    }
  }

  /**
   * Localize one picture (`source`: a canvas or an image, of a size) and show where it is. Null where a newer picture
   * was asked for meanwhile: what comes late is not shown.
   */
  async localize(blob, source, prior, extra) {
    const number = ++this.#asked;
    this.#question.abort();
    this.#question = new AbortController();
    const intrinsics = this.intrinsicsOf(source.width, source.height);
    const query = { ...this.queryOf(intrinsics), ...prior, with_matches: true };
    let found;
    try {
      found = await rholoc.call("POST", path`v1/maps/${this.map.name}/localize`, {
        body: blob,
        query,
        signal: AbortSignal.any([this.signal, this.#question.signal]),
      });
    } catch (error) {
      if (number !== this.#asked) return null;
      throw error;
    }
    if (number !== this.#asked) return null;
    this.draw(source, found);
    fill(this.copying, copyButtons(this.map, query, this.still?.name ?? "frame.jpg", blob.type));
    this.copying.hidden = false;
    const landmarks = found.localized ? found.agreeing.landmarks : [];
    const extents = found.camera ? halfExtents(found.camera, source.width, source.height) : intrinsics.extents;
    this.scene.showPose(found.pose?.T_map_camera ?? null, landmarks, extents);
    this.tell(found, intrinsics.known, extra?.());
    return found;
  }

  /** What is asked with, how far it is known, how far the picture reaches, and the camera, which is a guess if unknown. */
  intrinsicsOf(width, height) {
    const chosen = this.intrinsics.value;
    let own = intrinsicsFor(this.map.camera, width, height);
    if (chosen === UNKNOWN || (chosen === AUTOMATIC && own.known !== Known.MEASURED))
      return {
        query: { intrinsics: "unknown" },
        known: Known.ESTIMATED,
        extents: halfExtents(own, width, height),
        camera: own,
      };
    if (chosen === FIELD_OF_VIEW) {
      const degrees = Number(this.degrees.value);
      if (!this.degrees.value || !this.degrees.checkValidity())
        throw new Error(t`Type the picture's horizontal field of view, or choose a camera.`);
      own = intrinsicsOfFieldOfView(degrees, width, height);
    } else {
      const stored = this.cameras.find(({ name }) => name === chosen);
      if (stored) own = intrinsicsFor(stored, width, height);
    }
    return { query: asQuery(own), known: own.known, extents: halfExtents(own, width, height), camera: own };
  }

  /** The picture alone. */
  show(source) {
    Object.assign(this.picture, { width: source.width, height: source.height });
    this.picture.getContext("2d").drawImage(source.image, 0, 0, source.width, source.height);
    this.picture.setAttribute("aria-label", t`The picture; it has no pose`);
    this.scene.showPose(null);
  }

  /** Neither a picture nor a pose. */
  clear() {
    this.still = null;
    this.copying.hidden = true;
    fill(this.landscape);
    fill(this.elsewhere);
    this.#asked++;
    this.#question.abort();
    this.picture.getContext("2d").clearRect(0, 0, this.picture.width, this.picture.height);
    this.picture.setAttribute("aria-label", t`No picture yet`);
    this.scene.showPose(null);
    this.scene.showTrack(null);
  }

  /** The frame, and the track up to it. */
  showTrack(source, track, known, extents, rate) {
    const { pose } = track.now;
    this.show(source);
    this.copying.hidden = true;
    this.scene.showTrack(track);
    this.scene.showPose(pose?.T_map_camera ?? null, [], extents);
    fill(
      this.answer,
      trackReport(track, reasons, rate),
      doubts({ localized: pose !== null }, known, this.map).map(doubt),
    );
  }

  /** The picture, and on it the features that the map recognised. */
  draw(source, found) {
    this.show(source);
    const context = this.picture.getContext("2d");
    const radius = Math.max(3, source.width / 160);
    context.lineWidth = radius / 2.5;
    context.strokeStyle = found.localized ? "#35e0a1" : "#ffb454";
    for (const [u, v] of found.agreeing.pixels) {
      context.beginPath();
      context.arc(u, v, radius, 0, 2 * Math.PI);
      context.stroke();
    }
    if (found.localized)
      this.picture.setAttribute("aria-label", t`The picture with ${found.inliers} features that the map recognised`);
  }

  tell(found, known, extra) {
    const { pose } = found;
    const metric = found.scale === "metric";
    fill(
      this.answer,
      h(
        "div",
        { class: "row" },
        h("span", { class: ["badge", found.localized ? "good" : "warn"] }, found.localized ? t`localized` : t`no pose`),
        found.localized && confidenceOf(found, known),
      ),
      !found.localized && reasons(found),
      doubts(found, known, this.map).map(doubt),
      facts([
        [t`Position`, pose && coordinates(pose.position) + (metric ? " m" : t` units`)],
        [t`In the area`, found.areas.join(", ") || null],
        [t`Near the point`, found.near.join(", ") || null],
        [t`Heading`, pose && coordinates(pose.heading)],
        [t`Off by about`, pose && offBy(found, known, metric)],
        [
          t`Focal length`,
          found.camera && t`${decimal(found.camera.fx)} px, estimated to ${decimal(found.camera.focal_sigma_px)} px`,
        ],
        [t`Matches`, t`${found.inliers} of ${found.matches} agree`],
        [t`Took`, [`${decimal(found.timings_ms.total)} ms`, extra].filter(Boolean).join(", ")],
      ]),
    );
  }

  /** Show an error; a pose from before it is not the answer to it. Once a server that is away is back, try `again`. */
  fail(error, again) {
    if (this.signal.aborted || error.name === "AbortError") return;
    this.scene.showPose(null);
    fill(this.landscape);
    fill(this.elsewhere);
    if (this.still) this.show(this.still.source);
    const { summary = error.message, hint, code } = error;
    fill(this.answer, problem({ summary, hint, code: again && code }));
    if (!again) return;
    const waiting = new AbortController();
    this.ends.push(() => waiting.abort());
    goOn(error, again, AbortSignal.any([this.signal, waiting.signal]));
  }
}

/** Why an answer has no pose. */
const reasons = ({ reason, diagnosis }) =>
  h("p", {}, diagnosis ? heard(`${diagnosis.message} ${diagnosis.hint}`) : reason);

const doubt = (text) => h("p", { class: "notice warn small" }, text);

/** How surely the place is right, and the pose exact; figures only where the intrinsics are not a guess. */
function confidenceOf(found, known) {
  if (known === Known.TYPED) return h("span", { class: "muted" }, t`confidence unknown`);
  const { recognized, confidence } = found;
  const highest = Math.round(100 * HIGHEST_SHOWN_CONFIDENCE);
  return [
    probability(
      recognized,
      recognized > HIGHEST_SHOWN_CONFIDENCE
        ? t`right place over ${highest} %`
        : t`right place ${Math.round(100 * recognized)} %`,
    ),
    probability(
      confidence,
      confidence > HIGHEST_SHOWN_CONFIDENCE
        ? t`confidence over ${highest} %`
        : t`confidence ${Math.round(100 * confidence)} %`,
    ),
  ];
}

const probability = (value, text) =>
  h("label", { class: "confidence" }, text, h("meter", { min: 0, max: 1, low: 0.5, high: 0.8, optimum: 1, value }));

/** Why an answer may be wrong however sure it is of itself. */
function doubts(found, known, map) {
  if (!found.localized) return [];
  return [
    trustOf(map) === Trust.NO && t`The map itself is not trusted: the pose may be wrong by more than is said here.`,
    known === Known.TYPED &&
      t`The field of view was typed, not measured: a few degrees off put the pose decimetres off. Calibrate the camera to know.`,
    known === Known.ESTIMATED &&
      t`The camera is not known; its focal length was estimated from this picture alone. A stored camera is more reliable.`,
    known === Known.ASSUMED &&
      t`The picture has another shape than the camera's. It is taken to be the same camera, turned or cropped; if it is not, the pose is wrong.`,
  ].filter(Boolean);
}

/** What the pose may be off by: the spread of the optimum, of which the map's own uncertainty is a part. */
function offBy(found, known, metric) {
  if (known === Known.TYPED) return t`unknown`;
  const { covariance } = found;
  const spread = covariance && Math.sqrt(covariance[0][0] + covariance[1][1] + covariance[2][2]);
  return Number.isFinite(spread) ? length(spread, metric) : t`unknown`;
}

/** The request as a program, to be copied: a button for each language. */
function copyButtons(map, query, file, type) {
  const code = h("pre", { tabindex: 0, hidden: true, "aria-label": t`The request as a program` });
  const { with_matches: _, ...options } = query;
  const buttons = LANGUAGES.map(([language, name]) =>
    action(t`Copy as ${name}`, async () => {
      const withKey = storedKey() !== null;
      code.textContent = snippet(language, {
        url: rholoc.url("").href,
        map: map.name,
        query: options,
        file,
        type,
        withKey,
      });
      code.hidden = false;
      await navigator.clipboard?.writeText(code.textContent);
      tell(navigator.clipboard ? t`Copied.` : t`Select the text below and copy it.`);
    }),
  );
  return [h("div", { class: "row" }, buttons, h("a", { class: "button", href: "docs" }, t`All routes`)), code];
}

function layout(trial, maps) {
  const choice = h(
    "select",
    { onchange: () => (location.hash = `#/try/${encodeURIComponent(choice.value)}`) },
    maps.map((map) => h("option", { value: map.name, selected: map.name === trial.map.name }, trusted(map))),
  );
  return page(
    t`Try it`,
    h("div", { class: "row" }, trustBadge(trial.map), field(t`Map`, choice)),
    trustOf(trial.map) === Trust.NO && mistrust(trial.map),
    h(
      "div",
      { class: "try-columns" },
      h("div", { class: "stack" }, dropZone(trial), sources(trial)),
      h("div", { class: "stack" }, trial.scene.element, trial.answer, trial.elsewhere, trial.landscape, trial.copying),
    ),
    h("details", { class: "card" }, h("summary", {}, t`Camera options`), options(trial)),
  );
}

/** Why a map is not to be relied on, and what to do. */
function mistrust({ name, trust_reason: why }) {
  return h(
    "p",
    { class: "notice bad small" },
    inPlainWords(why)?.plain,
    " ",
    whatToDo(Trust.NO, [], why),
    " ",
    h("a", { href: `#/maps/${encodeURIComponent(name)}` }, t`To the map`),
  );
}

function options(trial) {
  const degrees = field(
    t`Horizontal field of view, °`,
    trial.degrees,
    t`of the picture, from its left to its right edge`,
  );
  degrees.hidden = true;
  fill(
    trial.intrinsics,
    h("option", { value: AUTOMATIC }, t`not specified: the map's if the shape matches, otherwise estimated`),
    h("option", { value: MAP_CAMERA }, t`the camera that made the map`),
    h("option", { value: UNKNOWN }, t`unknown: estimate its focal length`),
    trial.cameras.map(({ name }) => h("option", { value: name }, name)),
    h("option", { value: FIELD_OF_VIEW }, t`another, by its field of view`),
  );
  trial.intrinsics.addEventListener("change", () => {
    degrees.hidden = trial.intrinsics.value !== FIELD_OF_VIEW;
    trial.again();
  });
  for (const input of [trial.degrees, trial.rolls]) input.addEventListener("change", () => trial.again());
  return h(
    "div",
    { class: "form" },
    field(t`Which camera took it?`, trial.intrinsics),
    degrees,
    h("label", { class: "check" }, trial.rolls, t`hand-held: the camera may roll`),
  );
}

function dropZone(trial) {
  const zone = h(
    "div",
    { class: "drop" },
    trial.picture,
    h("p", { class: "drop-hint muted" }, t`Drop a picture, a video or a trajectory (CSV) here`),
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
    accept: "image/*,video/*,.csv",
    class: "visually-hidden",
    "aria-label": t`Picture, video or trajectory`,
    onchange: () => {
      if (input.files.length) takeFile(trial, input.files[0]);
      input.value = "";
    },
  });
  trial.player = h("div", { class: "row", hidden: true });
  trial.cameraButton = h(
    "button",
    { type: "button", onclick: () => (trial.filming ? trial.stop() : film(trial, useCamera)) },
    t`Use the camera`,
  );
  return h(
    "div",
    { class: "stack" },
    h(
      "div",
      { class: "row" },
      h("label", { class: "button file" }, t`Choose a file`, input),
      trial.cameraButton,
      h("label", { class: "check" }, trial.tracks, t`track from frame to frame`),
    ),
    trial.player,
  );
}

async function takeFile(trial, file) {
  trial.stop();
  trial.clear();
  trial.picture.closest(".drop").classList.add("taken");
  try {
    if (/\.csv$/i.test(file.name)) playTrajectory(trial, readTrajectory(await file.text()));
    else if (file.type.startsWith("video/")) await film(trial, (_, signal) => videoFrames(file, signal));
    else await trial.tryStill(await readPicture(file));
  } catch (error) {
    if (!trial.still) trial.picture.closest(".drop").classList.remove("taken"); // nothing is in the frame
    trial.fail(error, trial.still && (() => trial.again()));
  }
}

function playTrajectory(trial, poses) {
  const { camera } = trial.map;
  const extents = halfExtents(camera, camera.width, camera.height);
  trial.scene.showTrail(poses.map(({ position }) => position));
  const end = play(trial.player, poses, ({ T }) => trial.scene.showPose(T, [], extents));
  trial.ends.push(() => {
    end();
    trial.scene.showTrail([]);
  });
  fill(
    trial.answer,
    facts([
      [t`Trajectory`, t`${poses.length} poses`],
      [t`Lasts`, `${decimal(poses.at(-1).time - poses[0].time, 1)} s`],
    ]),
  );
}

const useCamera = (map, signal) => cameraFrames(map, signal);

/**
 * Show where the frames of a film are, one after the other, until it ends or is stopped. `framesOf` gives them, of the map
 * and a signal that ends them.
 */
async function film(trial, framesOf) {
  trial.stop();
  trial.filming = true;
  const stopping = new AbortController();
  const signal = AbortSignal.any([trial.signal, stopping.signal]);
  const times = [];
  let step;
  trial.ends.push(() => {
    stopping.abort();
    trial.filming = false;
    trial.cameraButton.textContent = t`Use the camera`;
  });
  try {
    for await (const frame of framesOf(trial.map, signal)) {
      if (!step) {
        trial.clear();
        trial.picture.closest(".drop").classList.add("taken");
        trial.cameraButton.textContent = framesOf === useCamera ? t`Stop the camera` : t`Stop the video`;
        step = trial.tracks.checked ? tracked(trial, signal) : eachAlone(trial);
      }
      if (signal.aborted) break;
      await step(frame, () => rate(times));
    }
  } catch (error) {
    const failed = !signal.aborted;
    trial.stop();
    if (failed) trial.fail(error, framesOf === useCamera && (() => film(trial, useCamera)));
  }
  if (!stopping.signal.aborted) trial.stop();
}

/** Localizes each frame, the last pose being the next one's prior. */
function eachAlone(trial) {
  let prior = {};
  return async ({ blob, source }, rated) => {
    const found = await trial.localize(blob, source, prior, rated);
    prior = found?.localized ? priorOf(found.pose) : {};
  };
}

/**
 * Streams the frames to the server, which tracks the camera. The first is localized by itself: that asks for a key where
 * one is needed, and estimates a focal length that is not known. Other options begin another track.
 */
function tracked(trial, signal) {
  let stream, begunWith, shown, rateShown;
  return async (frame, rated) => {
    const chosen = [trial.intrinsics.value, trial.degrees.value, trial.rolls.checked].join();
    if (stream && chosen !== begunWith) {
      stream.close();
      stream = null;
    }
    shown = frame.source;
    rateShown = rated();
    if (!stream) {
      const found = await trial.localize(frame.blob, frame.source, {}, () => rateShown);
      const { known, extents, camera } = trial.intrinsicsOf(frame.source.width, frame.source.height);
      if (!found || (known === Known.ESTIMATED && !found.localized)) return;
      const track = new Track();
      trial.ends.push(() => {
        track.ended = true;
        if (track.now) fill(trial.answer, trackReport(track, reasons, null));
      });
      const show = (message) => {
        track.take(message);
        trial.showTrack(shown, track, known, extents, rateShown);
      };
      begunWith = chosen;
      const { fx, fy, cx, cy, distortion, lens } = { distortion: [], ...(found.camera ?? camera) };
      const begin = { camera: { fx, fy, cx, cy, distortion, lens }, dof: trial.rolls.checked ? "auto" : 5 };
      stream = await rholoc.track(trial.map.name, begin, show, { signal });
    }
    const due = performance.now() + TRACK_MS;
    await stream.frame(frame.time, frame.blob);
    await new Promise((resolve) => setTimeout(resolve, due - performance.now()));
  };
}

/** How many frames are answered a second, now that one more is. */
function rate(times) {
  times.push(performance.now());
  if (times.length > RATE_OVER) times.shift();
  const hertz = times.length > 1 ? (1000 * (times.length - 1)) / (times.at(-1) - times[0]) : 0;
  return t`${decimal(hertz, 1)} frames a second`;
}

function priorOf({ position, heading }) {
  return { prior_position: position.join(","), prior_heading: heading.join(","), prior_radius_m: PRIOR_RADIUS_M };
}

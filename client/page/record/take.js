// A recording being made: video, inertial rows and frame times, handed to the store second by second.

import { t } from "../shared/text.js";
import { videoType, watchFrames } from "./camera.js";
import { State } from "./store.js";

const PART_MS = 1000;
const BITS_PER_SECOND = 8_000_000;

/** Why a recording ended. */
export const Ending = Object.freeze({
  STOPPED: "stopped",
  HIDDEN: "hidden", // the page was left
  TURNED: "turned", // the picture changed its shape
  FULL: "full", // no room
  CAMERA: "camera", // the camera went away
  BROKEN: "broken", // the page was closed or reloaded
});

/** The message about an ending that nobody asked for. */
export const ENDINGS = {
  [Ending.HIDDEN]: t`Recording ended when you left this page: a phone shuts the camera off then. What came before is kept.`,
  [Ending.TURNED]: t`Recording ended when the phone was turned: a recording has one shape. What came before is kept.`,
  [Ending.FULL]: t`Recording ended because this phone has no space left. What came before is kept.`,
  [Ending.BROKEN]: t`Recording broke off. What came before is kept.`,
  [Ending.CAMERA]: t`Recording ended because the camera went away. What came before is kept.`,
};

/** From `start` until its promise `ended`, which gives the recording's description. */
export class Take {
  #part = { imu: [], frames: [] };
  #index = 0;
  #writing = Promise.resolve();
  /** @type {string} */
  #ending = Ending.STOPPED;
  #last = {}; // what the recording was before its last part
  #cleanUp = [];

  constructor(store, recording, { stream, video, sensors }) {
    this.store = store;
    this.recording = recording;
    this.stream = stream;
    this.video = video;
    this.sensors = sensors;
    this.recorder = new MediaRecorder(stream, { mimeType: videoType(), videoBitsPerSecond: BITS_PER_SECOND });
  }

  /** Seconds on the clock. */
  static now() {
    return performance.now() / 1000;
  }

  /** Seconds since the start. */
  get elapsed() {
    return Take.now() - this.recording.started;
  }

  start() {
    const listen = (target, type, hear) => {
      target.addEventListener(type, hear);
      this.#cleanUp.push(() => target.removeEventListener(type, hear));
    };
    this.ended = new Promise((resolve) => listen(this.recorder, "stop", () => resolve(this.#finish())));
    listen(this.recorder, "dataavailable", ({ data }) => this.#keep(data));
    listen(this.recorder, "error", () => this.stop(Ending.CAMERA));
    listen(this.stream.getVideoTracks()[0], "ended", () => this.stop(Ending.CAMERA));
    listen(document, "visibilitychange", () => document.hidden && this.stop(Ending.HIDDEN));
    listen(this.video, "resize", () => this.stop(Ending.TURNED));
    listen(screen.orientation ?? window, screen.orientation ? "change" : "orientationchange", () =>
      this.stop(Ending.TURNED),
    );
    listen(this.sensors, "row", ({ detail }) => this.#part.imu.push(detail));
    this.#cleanUp.push(watchFrames(this.video, (time) => this.#part.frames.push(time)));
    const started = Take.now();
    this.recorder.start(PART_MS);
    this.recording = { ...this.recording, state: State.RECORDING, started, duration: 0, bytes: 0 };
  }

  /**
   * End the recording. What was recorded is kept, whatever the reason.
   * @param {string} ending
   */
  stop(ending = Ending.STOPPED) {
    if (this.recorder.state === "inactive") return;
    this.#ending = ending;
    this.recorder.stop();
  }

  #keep(video) {
    const part = { index: this.#index++, video, ...this.#part };
    this.#part = { imu: [], frames: [] };
    const { elapsed } = this;
    this.#writing = this.#writing.then(() => this.#write(part, elapsed));
  }

  /**
   * Keep a part, unless an earlier one could not be kept: a video has no gaps. The last part that there was room for
   * makes room for the description.
   */
  async #write(part, duration) {
    if (this.#ending === Ending.FULL) return;
    const { id, duration: before, bytes } = this.recording;
    const grown = { type: this.recorder.mimeType, duration, bytes: bytes + part.video.size };
    try {
      await this.store.add({ ...this.recording, ...grown }, part);
      Object.assign(this.recording, grown);
      this.#last = { duration: before, bytes };
    } catch {
      this.stop(Ending.FULL);
      this.#ending = Ending.FULL;
      await this.store.removePart(id, part.index - 1);
      Object.assign(this.recording, this.#last);
    }
  }

  async #finish() {
    for (const undo of this.#cleanUp) undo();
    await this.#writing;
    return { ...this.recording, state: State.STOPPED, ending: this.#ending };
  }
}

// A stream of frames to the server, over a WebSocket: a pose for each comes back. The track is kept there; the server's
// README describes the messages.

import { ApiError, path, storedKey, url } from "../shared/api.js";
import { t } from "../shared/text.js";

const PROTOCOL = "rholoc.track.1";
const KEY_PROTOCOL = "rholoc.key."; // a browser sends no headers with a WebSocket

export class TrackStream {
  /** @type {{resolve: Function, reject: Function} | null} */
  #asked = null;
  #hear;

  /**
   * Begin a track in a map.
   * @param {string} map
   * @param {{camera?: object, dof?: string | number}} begin what holds for all frames
   * @param {(tracked: any) => void} hear what is known whenever it changes
   * @param {AbortSignal} signal ends it
   * @throws {ApiError} what the server objects to, or that it cannot be reached.
   */
  static async open(map, begin, hear, signal) {
    const address = url(path`v1/maps/${map}/track`);
    address.protocol = address.protocol.replace("http", "ws");
    const key = storedKey();
    const socket = new WebSocket(address, key ? [PROTOCOL, KEY_PROTOCOL + key] : [PROTOCOL]);
    const stream = new TrackStream(socket, hear);
    signal.addEventListener("abort", () => stream.close(), { once: true });
    const begun = stream.#answer();
    socket.addEventListener("open", () => socket.send(JSON.stringify({ type: "begin", ...begin })));
    await begun;
    return stream;
  }

  constructor(socket, hear) {
    this.socket = socket;
    this.#hear = hear;
    socket.addEventListener("message", ({ data }) => this.#take(JSON.parse(data)));
    socket.addEventListener("close", () => this.#fail({ code: "unreachable", message: t`The connection broke off.` }));
  }

  /** Send a frame, taken `time` s into any one clock; resolves once the server has taken it in. One at a time. */
  async frame(time, picture) {
    const taken = this.#answer();
    if (this.socket.readyState !== WebSocket.OPEN)
      this.#fail({ code: "unreachable", message: t`The connection broke off.` });
    else {
      this.socket.send(JSON.stringify({ type: "frame", time_s: time, picture: true }));
      this.socket.send(picture);
    }
    return taken;
  }

  close() {
    this.#hear = () => {};
    this.socket.close();
  }

  #answer() {
    return new Promise((resolve, reject) => (this.#asked = { resolve, reject }));
  }

  #take(message) {
    if (message.type === "error") return this.#fail(message);
    if (message.type === "tracked") this.#hear(message);
    if (message.type === "begun" || message.answer === null) this.#asked?.resolve(message);
  }

  #fail(error) {
    this.#asked?.reject(new ApiError(error));
    this.#asked = null;
  }
}

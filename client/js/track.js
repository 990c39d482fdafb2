// A camera that the service follows: frames go there over a WebSocket, a pose for each comes back. The track is kept there;
// the server's README describes the messages.

const PROTOCOL = "rholoc.track.1";
const KEY_PROTOCOL = "rholoc.key."; // a browser sends no headers with a WebSocket

/** What {@link Client.track} gives. */
export class TrackStream {
  /** @type {{resolve: Function, reject: Function} | null} */
  #asked = null;
  #socket;
  #onTracked;
  #errorOf;

  /** Begin a track; `errorOf` makes the error of what the service said, or of nothing. */
  static async open(address, key, begin, onTracked, errorOf, signal) {
    if (signal?.aborted) throw errorOf();
    const socket = new WebSocket(address, key ? [PROTOCOL, KEY_PROTOCOL + key] : [PROTOCOL]);
    const stream = new TrackStream(socket, onTracked, errorOf);
    signal?.addEventListener("abort", () => stream.close(), { once: true });
    const begun = stream.#answer();
    socket.addEventListener("open", () => stream.#asked && socket.send(JSON.stringify({ type: "begin", ...begin })));
    await begun;
    return stream;
  }

  constructor(socket, onTracked, errorOf) {
    this.#socket = socket;
    this.#onTracked = onTracked;
    this.#errorOf = errorOf;
    socket.addEventListener("message", ({ data }) => this.#take(JSON.parse(data)));
    socket.addEventListener("close", () => this.#fail());
  }

  /**
   * Send a frame; resolves once the service has taken it in. One at a time.
   * @param {number} time_s when it was taken, on any one clock
   * @param {Blob | BufferSource} picture
   * @throws {RholocError} what the service objects to, or that the connection broke off
   */
  async frame(time_s, picture) {
    const taken = this.#answer();
    if (this.#socket.readyState === WebSocket.OPEN) {
      this.#socket.send(JSON.stringify({ type: "frame", time_s, picture: true }));
      this.#socket.send(picture);
    } else this.#fail();
    return taken;
  }

  close() {
    this.#onTracked = () => {};
    if (this.#socket.readyState !== WebSocket.CONNECTING) {
      this.#socket.close();
      return;
    }
    this.#socket.addEventListener("open", () => this.#socket.close()); // before that, the browser would log an error
    this.#fail();
  }

  /** @returns {Promise<any>} */
  #answer() {
    return new Promise((resolve, reject) => (this.#asked = { resolve, reject }));
  }

  #take(message) {
    if (message.type === "error") return this.#fail(message);
    if (message.type === "tracked") this.#onTracked(message);
    if (message.type === "begun" || message.answer === null) this.#asked?.resolve(message);
  }

  #fail(error) {
    this.#asked?.reject(this.#errorOf(error));
    this.#asked = null;
  }
}

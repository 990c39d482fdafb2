// The service over HTTP, with what every browser has: a method for each call, and one kind of error.

import { TrackStream } from "./track.js";

const PIECE = 2 ** 21;
const TUS = { "Tus-Resumable": "1.0.0" };
const TRIES = 5;
const PAUSES_S = [1, 2, 4, 8, 15, 30];
const ENDED = new Set(["published", "failed", "cancelled"]);
const UNREACHABLE = {
  code: "unreachable",
  message: "The server does not answer.",
  hint: "Check the connection and try again.",
};
const BROKE_OFF = { code: "unreachable", message: "The connection broke off." };

/** What the service answered instead of what was asked for; the code is "unreachable" where there was no answer. */
export class RholocError extends Error {
  constructor({ code, message, hint = "", request_id = "" }, status = 0, cause = undefined) {
    super([message, hint].filter(Boolean).join(" "), { cause });
    this.name = "RholocError";
    this.code = code;
    this.summary = message;
    this.hint = hint;
    this.status = status;
    this.requestId = request_id;
  }

  /** Whether the same request may succeed later. */
  get passes() {
    return this.code === "unreachable" || [408, 423, 429, 502, 503, 504].includes(this.status);
  }
}

/** A path with its parts escaped: path`v1/maps/${name}`. */
export function path(texts, ...values) {
  return texts.reduce((whole, text, i) => whole + encodeURIComponent(values[i - 1]) + text);
}

/**
 * A rholoc service.
 *
 *     const rholoc = new Client("https://rholoc.example", { key });
 *     const answer = await rholoc.localize("hall", jpeg, { camera: { fx: 1510, fy: 1510, cx: 960, cy: 540 } });
 *     if (answer.localized) console.log(answer.pose.position, answer.recognized);
 */
export class Client {
  #base;
  #key;
  #fetch;
  #translate;
  #onRefused;

  /**
   * @param {string | URL} address of the service
   * @param {object} [options]
   * @param {string | (() => string | null)} [options.key] the API key, where the service asks for one, or what gives it
   * @param {typeof fetch} [options.fetch]
   * @param {(text: string) => string} [options.translate] messages and hints of errors into another language
   * @param {(error: RholocError) => Promise<boolean>} [options.onRefused] called where the key is missing or does not suffice;
   *   gives whether there is another one, with which the request is made again
   */
  constructor(
    address,
    { key = "", fetch = globalThis.fetch, translate = (text) => text, onRefused = async () => false } = {},
  ) {
    this.#base = new URL(`${String(address).replace(/\/+$/, "")}/`);
    this.#key = typeof key === "function" ? key : () => key;
    this.#fetch = fetch;
    this.#translate = translate;
    this.#onRefused = onRefused;
  }

  /**
   * Where a picture was taken. "No pose" is an answer, with a reason, not an error.
   * @param {string | string[]} map a map's name; several, or "all", to find it in any of them
   * @param {Blob | BufferSource} image JPEG, PNG or WebP
   * @param {import("./types/api.d.ts").LocalizeOptions} options
   * @param {{signal?: AbortSignal}} how
   * @returns {Promise<import("./types/api.d.ts").LocalizationOut>}
   */
  async localize(map, image, options = {}, { signal } = {}) {
    const body = new FormData();
    body.append("image", image instanceof Blob ? image : new Blob([image]), "image");
    body.append("request", new Blob([JSON.stringify(options)], { type: "application/json" }), "request.json");
    if (Array.isArray(map) || map === "all")
      return this.call("POST", "v1/localize", { body, signal, query: { maps: [map].flat().join(",") } });
    return this.call("POST", path`v1/maps/${map}/localize`, { body, signal });
  }

  /**
   * Follow a camera in a map; resolves once the service is ready for frames.
   * @param {string} map
   * @param {{camera?: object, dof?: string | number}} begin what holds for all frames
   * @param {(tracked: any) => void} onTracked hears what is known of the camera whenever that changes
   * @param {{signal?: AbortSignal}} how the signal ends it
   * @throws {RholocError} what the service objects to, or `unreachable`, also if the signal ends it while it connects
   */
  track(map, begin, onTracked, { signal } = {}) {
    const address = this.url(path`v1/maps/${map}/track`);
    address.protocol = address.protocol.replace("http", "ws");
    const failed = (error) => this.#error(error ?? BROKE_OFF);
    return TrackStream.open(address, this.#key(), begin, onTracked, failed, signal);
  }

  /**
   * All maps.
   * @returns {Promise<import("./types/api.d.ts").MapSummary[]>}
   */
  async maps() {
    return (await this.get("v1/maps")).maps;
  }

  /**
   * One map, with its named points and areas.
   * @param {string} name
   * @returns {Promise<import("./types/api.d.ts").MapDetail>}
   */
  map(name) {
    return this.get(path`v1/maps/${name}`);
  }

  /**
   * A job: its status, and how far it is.
   * @param {string} id
   * @returns {Promise<import("./types/api.d.ts").JobOut>}
   */
  job(id) {
    return this.get(path`v1/jobs/${id}`);
  }

  /**
   * Follow a job until it ends, through breaks of the connection; resolves to the job as it ended.
   * @param {string} id
   * @param {object} [options]
   * @param {(job: import("./types/api.d.ts").JobOut) => void} [options.onChange]
   * @param {(error: RholocError) => void} [options.onLost] there is no connection; it is waited for
   * @param {AbortSignal} [options.signal]
   * @returns {Promise<import("./types/api.d.ts").JobOut>}
   */
  async waitForJob(id, { onChange = () => {}, onLost = () => {}, signal } = {}) {
    for (;;) {
      try {
        for await (const job of this.events(path`v1/jobs/${id}/events`, { signal })) {
          onChange(job);
          if (ENDED.has(job.state)) return job;
        }
      } catch (error) {
        if (!error.passes) throw error;
        onLost(error);
      }
      await pause(PAUSES_S[0], signal);
    }
  }

  /**
   * Send a recording, in pieces that go on where they broke off; resolves to the id of the job that makes a map of it.
   * @param {Blob} recording a video, or a zip archive of a recording's files
   * @param {object} options
   * @param {string} options.map
   * @param {string} [options.name] of the file
   * @param {string} [options.kind] "build" a map (the default), or "update" the one there is
   * @param {string} [options.camera] one that the service knows, by name
   * @param {string | null} [options.location] where an earlier try stands
   * @param {number} [options.tries] failures in a row after which to give up
   * @param {(sent: number, total: number) => void} [options.onProgress]
   * @param {(location: string | null) => void} [options.onLocation] where to go on after a reload; null where it is gone
   * @param {(error: RholocError) => void} [options.onWaiting] it failed, and is tried again
   * @param {AbortSignal} [options.signal]
   * @returns {Promise<string>}
   */
  async upload(
    recording,
    {
      location = null,
      tries = TRIES,
      onProgress = () => {},
      onLocation = () => {},
      onWaiting = () => {},
      signal,
      name = "walk.mp4",
      ...metadata
    },
  ) {
    for (let failures = 0; ; ) {
      try {
        if (!location) {
          location = await this.#begin({ filename: name, ...metadata }, recording.size, signal);
          onLocation(location);
        }
        let standing = standingOf(await this.request("HEAD", location, { headers: TUS, signal }));
        while (standing.offset < recording.size) {
          onProgress(standing.offset, recording.size);
          standing = await this.#send(location, recording, standing.offset, signal);
          failures = 0;
        }
        onProgress(recording.size, recording.size);
        return standing.job;
      } catch (error) {
        if (!(error instanceof RholocError) || ++failures >= tries) throw error;
        if (location && [404, 410].includes(error.status)) {
          location = null; // it expired, or the service lost it
          onLocation(location);
        } else if (!error.passes && error.status !== 409) throw error;
        onWaiting(error);
        await pause(PAUSES_S[Math.min(failures, PAUSES_S.length) - 1], signal);
      }
    }
  }

  async #begin(metadata, size, signal) {
    const described = Object.entries(metadata).filter(([, value]) => value);
    const text = described.map(([key, value]) => `${key} ${base64(value)}`).join(",");
    const headers = { ...TUS, "Upload-Length": String(size), "Upload-Metadata": text };
    const made = await this.request("POST", "v1/recordings", { headers, signal });
    return new URL(made.headers.get("Location"), this.#base).href;
  }

  async #send(location, recording, offset, signal) {
    const headers = { ...TUS, "Upload-Offset": String(offset), "Content-Type": "application/offset+octet-stream" };
    const body = recording.slice(offset, offset + PIECE);
    return standingOf(await this.request("PATCH", location, { headers, body, signal }));
  }

  /**
   * What a stream of events holds, as JSON, until it ends: `v1/jobs/ID/events`, `v1/maps/NAME/live`.
   * @param {string} where
   * @param {{signal?: AbortSignal}} how
   * @returns {AsyncGenerator<any>}
   */
  async *events(where, { signal } = {}) {
    const response = await this.request("GET", where, { signal, headers: { Accept: "text/event-stream" } });
    const reader = response.body.pipeThrough(new TextDecoderStream()).getReader();
    const read = () =>
      reader.read().catch((error) => {
        throw signal?.aborted ? error : this.#error(BROKE_OFF, 0, error);
      });
    try {
      let text = "";
      for (let piece = await read(); !piece.done; piece = await read()) {
        text += piece.value.replaceAll("\r", "");
        const blocks = text.split("\n\n");
        text = blocks.pop();
        for (const block of blocks) {
          const data = [...block.matchAll(/^data: ?(.*)$/gm)].map((match) => match[1]).join("\n");
          if (data) yield JSON.parse(data);
        }
      }
    } finally {
      reader.cancel().catch(() => {});
    }
  }

  /** What a GET of any route answers, as {@link call} does. */
  get(where, options = {}) {
    return this.call("GET", where, options);
  }

  /** What a GET of a route answers that is no JSON: a map's scene or room, a file. */
  async bytes(where, options = {}) {
    return (await this.request("GET", where, options)).arrayBuffer();
  }

  /**
   * What any route answers, as JSON; null where it answers nothing.
   * @param {string} method
   * @param {string} where the path, such as path`v1/sites/${name}`
   * @param {{query?: object, body?: any, headers?: Record<string, string>, signal?: AbortSignal}} options
   * @returns {Promise<any>}
   */
  async call(method, where, options = {}) {
    const response = await this.request(method, where, options);
    if (response.status === 204) return null;
    try {
      return await response.json();
    } catch (error) {
      const message = `${response.url} did not answer as rholoc does.`;
      throw this.#error({ code: "invalid_answer", message }, response.status, error);
    }
  }

  /**
   * The response of any route.
   * @param {string} method
   * @param {string} where
   * @param {{query?: object, body?: any, headers?: Record<string, string>, signal?: AbortSignal}} options a body is sent as JSON
   *   unless it is a Blob, FormData or bytes
   * @throws {RholocError} for every answer but success, and where there is none
   */
  async request(method, where, { query, body, headers, signal } = {}) {
    const raw = [Blob, FormData, ArrayBuffer].some((kind) => body instanceof kind) || ArrayBuffer.isView(body);
    const json = body === undefined || raw ? {} : { "Content-Type": "application/json" };
    const sent = /** @type {BodyInit | undefined} */ (body === undefined || raw ? body : JSON.stringify(body));
    const fetch = this.#fetch;
    for (;;) {
      const all = { ...json, ...headers, ...this.authorization };
      const response = await fetch(this.url(where, query), {
        method,
        body: sent,
        headers: all,
        signal,
        credentials: "omit",
      }).catch((error) => {
        throw signal?.aborted ? error : this.#error(UNREACHABLE, 0, error);
      });
      if (response.ok) return response;
      const error = await this.#refusal(response);
      const keyWouldHelp = response.status === 401 || error.code === "forbidden";
      if (!keyWouldHelp || !(await this.#onRefused(error))) throw error;
    }
  }

  /** The headers that prove who asks; none without a key. */
  get authorization() {
    const key = this.#key();
    return key ? { Authorization: `Bearer ${key}` } : {};
  }

  /** The address of a path; what is empty in the query is left out. */
  url(where, query = {}) {
    const address = new URL(where, this.#base);
    for (const [name, value] of Object.entries(query))
      if (value !== null && value !== undefined && value !== "") address.searchParams.set(name, value);
    return address;
  }

  async #refusal(response) {
    const said = await response.json().catch(() => null);
    const other = { code: "error", message: `The server answered with status ${response.status}.` };
    return this.#error(typeof said?.message === "string" ? said : other, response.status);
  }

  /** The error that a body reports, translated. */
  #error(body, status = 0, cause = undefined) {
    const [message, hint] = [body.message, body.hint ?? ""].map(this.#translate);
    return new RholocError({ ...body, message, hint }, status, cause);
  }
}

const base64 = (text) => btoa(String.fromCharCode(...new TextEncoder().encode(text)));
const standingOf = ({ headers }) => ({ offset: Number(headers.get("Upload-Offset")), job: headers.get("Rholoc-Job") });

/** Wait, but no longer than until the connection is back. */
function pause(seconds, signal) {
  return new Promise((resolve, reject) => {
    const over = new AbortController();
    const end = (settle) => {
      clearTimeout(timer);
      over.abort();
      settle();
    };
    const timer = setTimeout(() => end(resolve), 1000 * seconds);
    globalThis.addEventListener?.("online", () => end(resolve), { signal: over.signal });
    signal?.addEventListener("abort", () => end(() => reject(signal.reason)), { signal: over.signal });
  });
}

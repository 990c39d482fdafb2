// The service over HTTP, with fetch alone: a method for each call, and one kind of error.

const PIECE = 2 ** 21;
const TUS = { "Tus-Resumable": "1.0.0" };
const TRIES = 5;
const PAUSE_MS = 1000;

/** What the service answered instead of what was asked for; the code is "unreachable" where there was no answer. */
export class RholocError extends Error {
  constructor({ code, message, hint = "", request_id = "" }, status = 0) {
    super([message, hint].filter(Boolean).join(" "));
    this.name = "RholocError";
    this.code = code;
    this.hint = hint;
    this.status = status;
    this.requestId = request_id;
  }

  /** Whether the same request may succeed later. */
  get passes() {
    return this.code === "unreachable" || [408, 423, 429, 502, 503, 504].includes(this.status);
  }
}

/**
 * A rholoc service.
 *
 *     const rholoc = new Client("https://rholoc.example", { key });
 *     const answer = await rholoc.localize("hall", jpeg, { camera: { fx: 1510, fy: 1510, cx: 960, cy: 540 } });
 *     if (answer.localized) console.log(answer.pose.position, answer.recognized);
 */
export class Client {
  /**
   * @param {string | URL} address of the service
   * @param {{key?: string, fetch?: typeof fetch}} options the API key, where the service asks for one
   */
  constructor(address, { key = "", fetch = globalThis.fetch } = {}) {
    this._base = new URL(`${String(address).replace(/\/+$/, "")}/`);
    this._headers = key ? { Authorization: `Bearer ${key}` } : {};
    this._fetch = fetch;
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
    const form = new FormData();
    form.append("image", image instanceof Blob ? image : new Blob([image]), "image");
    form.append("request", new Blob([JSON.stringify(options)], { type: "application/json" }), "request.json");
    const several = Array.isArray(map) || map === "all";
    const where = several
      ? `v1/localize?maps=${encodeURIComponent([map].flat().join(","))}`
      : `${mapPath(map)}/localize`;
    return this._json("POST", where, { body: form, signal });
  }

  /**
   * All maps.
   * @returns {Promise<import("./types/api.d.ts").MapSummary[]>}
   */
  async maps() {
    return (await this._json("GET", "v1/maps")).maps;
  }

  /**
   * One map, with its named points and areas.
   * @param {string} name
   * @returns {Promise<import("./types/api.d.ts").MapDetail>}
   */
  map(name) {
    return this._json("GET", mapPath(name));
  }

  /**
   * A job: its status, and how far it is.
   * @param {string} id
   * @returns {Promise<import("./types/api.d.ts").JobOut>}
   */
  job(id) {
    return this._json("GET", `v1/jobs/${encodeURIComponent(id)}`);
  }

  /**
   * Send a recording, in pieces that go on where they broke off; resolves to the id of the job that makes a map of it.
   * @param {Blob} recording a video, or a zip archive of a recording's files
   * @param {{map: string, name?: string, onProgress?: (sent: number, total: number) => void, signal?: AbortSignal}} options
   */
  async upload(recording, { map, name = "walk.mp4", onProgress = () => {}, signal }) {
    const metadata = Object.entries({ map, filename: name }).map(([key, value]) => `${key} ${base64(value)}`);
    const headers = { ...TUS, "Upload-Length": String(recording.size), "Upload-Metadata": metadata.join(",") };
    const made = await this._request("POST", "v1/recordings", { headers, signal });
    const location = new URL(made.headers.get("Location"), this._base).href;
    let standing = { offset: 0, job: null };
    for (let failures = 0; standing.offset < recording.size; ) {
      try {
        if (failures > 0) standing = await this._stand(location, signal);
        if (standing.offset < recording.size) standing = await this._send(location, recording, standing.offset, signal);
        onProgress(standing.offset, recording.size);
        failures = 0;
      } catch (error) {
        if (!(error instanceof RholocError) || !error.passes || ++failures >= TRIES) throw error;
        await new Promise((resolve) => setTimeout(resolve, failures * PAUSE_MS));
      }
    }
    return standing.job;
  }

  async _stand(location, signal) {
    return standingOf(await this._request("HEAD", location, { headers: TUS, signal }));
  }

  async _send(location, recording, offset, signal) {
    const headers = { ...TUS, "Upload-Offset": String(offset), "Content-Type": "application/offset+octet-stream" };
    const body = recording.slice(offset, offset + PIECE);
    return standingOf(await this._request("PATCH", location, { headers, body, signal }));
  }

  async _json(method, where, options = {}) {
    const response = await this._request(method, where, options);
    try {
      return await response.json();
    } catch {
      throw new RholocError({ code: "invalid_answer", message: `${response.url} did not answer as rholoc does.` });
    }
  }

  /**
   * @param {string} method
   * @param {string} where
   * @param {RequestInit} options
   * @throws {RholocError} for every answer but success, and where there is none
   */
  async _request(method, where, { headers, ...options } = {}) {
    const address = new URL(where, this._base);
    let response;
    try {
      const { _fetch } = this;
      response = await _fetch(address, {
        method,
        ...options,
        headers: { ...headers, ...this._headers },
        credentials: "omit",
      });
    } catch (error) {
      if (error.name === "AbortError") throw error;
      throw new RholocError({ code: "unreachable", message: `${address.origin} does not answer.` });
    }
    if (response.ok) return response;
    let body;
    try {
      body = await response.json();
    } catch {
      body = { code: "error", message: `${address} answered with status ${response.status}.` };
    }
    throw new RholocError(body, response.status);
  }
}

const mapPath = (name) => `v1/maps/${encodeURIComponent(name)}`;
const base64 = (text) => btoa(String.fromCharCode(...new TextEncoder().encode(text)));
const standingOf = ({ headers }) => ({ offset: Number(headers.get("Upload-Offset")), job: headers.get("Rholoc-Job") });

// The service over HTTP: one function per kind of call, errors in one shape, and the API key where one is asked for.

import { ask, h } from "./dom.js";
import { heard, t } from "./text.js";

const BASE = new URL("../../", import.meta.url);
const KEY = "rholoc-api-key";
const LOOK_MS = 2000;

/** What the service, or the way to it, answered instead of what was asked for. */
export class ApiError extends Error {
  constructor({ code, message, hint = "", request_id = "" }, status = 0) {
    message = heard(message);
    hint = heard(hint);
    super([message, hint].filter(Boolean).join(" "));
    this.code = code;
    this.hint = hint;
    this.status = status;
    this.requestId = request_id;
    this.summary = message;
  }
}

/** The absolute URL of a path of the service, given without a slash in front: `v1/maps`. */
export function url(path, query = {}) {
  const address = new URL(path, BASE);
  for (const [name, value] of Object.entries(query)) {
    if (value !== null && value !== undefined && value !== "") address.searchParams.set(name, value);
  }
  return address;
}

/** A path with its parts escaped: path`v1/maps/${name}`. */
export function path(texts, ...values) {
  return texts.reduce((whole, text, i) => whole + encodeURIComponent(values[i - 1]) + text);
}

/** The key that this window was opened with, or that is stored in this browser; or null. */
export const storedKey = () => sessionStorage.getItem(KEY) ?? localStorage.getItem(KEY);

/**
 * Take over the key of a link, `#/key/KEY/REST`, and leave `#/REST` in the address. It is this window's; where the browser
 * has no other, it is kept if `keep` says so.
 */
export function takeKeyOfLink(keep = false) {
  const found = location.hash.match(/^#\/key\/([\w-]+)(\/.*)?$/);
  if (!found) return;
  sessionStorage.setItem(KEY, found[1]);
  if (keep && !localStorage.getItem(KEY)) localStorage.setItem(KEY, found[1]);
  history.replaceState(null, "", `#${found[2] ?? "/"}`);
}

/** Store a key in this browser, or none. The page's `keychange` event says so. */
export function storeKey(key) {
  sessionStorage.removeItem(KEY);
  if (key) localStorage.setItem(KEY, key);
  else localStorage.removeItem(KEY);
  dispatchEvent(new Event("keychange"));
}

/** The headers that prove who asks; none without a key. For uploads that do not go through `request`. */
export function authorization() {
  const key = storedKey();
  return key ? { Authorization: `Bearer ${key}` } : {};
}

/**
 * The response of the service. Where the stored key is missing, not valid or not allowed to do this, the user is asked
 * for another, until one will do or the question is closed.
 * @param {string} where
 * @param {RequestInit & {query?: object}} options
 * @throws {ApiError} for every other answer, and with the code `unreachable` where there is none.
 */
export async function request(where, { query, headers, ...options } = {}) {
  const response = await send(url(where, query), { ...options, headers: { ...headers, ...authorization() } });
  if (response.ok) return response;
  const error = await errorOf(response);
  const keyWouldHelp = response.status === 401 || error.code === "forbidden";
  if (keyWouldHelp && (await askForKey(error))) return request(where, { query, headers, ...options });
  throw error;
}

/**
 * What the service answers, as JSON; `body` is sent as JSON unless it is a Blob or FormData.
 * @param {string} method
 * @param {string} where
 * @param {{body?: any, headers?: object, query?: object, signal?: AbortSignal}} options
 */
export async function call(method, where, { body, headers, ...options } = {}) {
  const raw = body === undefined || body instanceof Blob || body instanceof FormData;
  const response = await request(where, {
    method,
    body: raw ? body : JSON.stringify(body),
    headers: raw ? headers : { "Content-Type": "application/json", ...headers },
    ...options,
  });
  return response.status === 204 ? null : response.json();
}

/** GET as JSON. */
export const get = (where, options) => call("GET", where, options);

/** GET as an object URL, for pictures; the caller revokes it. */
export async function objectUrl(where, options) {
  return URL.createObjectURL(await (await request(where, options)).blob());
}

/** Save what a GET answers under a name, as the browser saves downloads. */
export async function download(where, name, options) {
  const address = await objectUrl(where, options);
  h("a", { href: address, download: name }).click();
  setTimeout(() => URL.revokeObjectURL(address), 60_000);
}

/** Whether an error is of a server that will be back. */
export const passes = (error) => error.code === "unreachable" || error.status >= 500;

/** Wait until the server answers again. */
export async function serverIsBack(signal) {
  for (;;) {
    await new Promise((resolve) => setTimeout(resolve, LOOK_MS));
    signal.throwIfAborted();
    try {
      const response = await send(url("v1/maps"), { headers: authorization(), signal });
      if (response.status < 500) return;
    } catch (error) {
      if (!passes(error)) throw error;
    }
  }
}

async function send(address, options) {
  try {
    return await fetch(address, { credentials: "omit", ...options });
  } catch (error) {
    if (error.name === "AbortError") throw error;
    throw new ApiError({
      code: "unreachable",
      message: t`The server does not answer.`,
      hint: t`Check the connection and try again.`,
    });
  }
}

/** The error that a response reports, in the one shape of all errors. */
export async function errorOf(response) {
  try {
    return new ApiError(await response.json(), response.status);
  } catch {
    return new ApiError(
      { code: "internal", message: t`The server answered with ${response.status}.` },
      response.status,
    );
  }
}

let asking = null;

/** Ask for an API key; true when one was given. Calls that come while the question stands wait for the same answer. */
export function askForKey(error) {
  asking ??= (async () => {
    const field = h("input", { name: "key", type: "password", required: true, autocomplete: "current-password" });
    const answer = await ask(
      t`API key`,
      [
        h("p", {}, error.summary),
        h("label", {}, t`Key`, field),
        h(
          "p",
          { class: "small muted" },
          t`It is kept in this browser. Whoever runs the server makes keys with rholoc key create.`,
        ),
      ],
      h("button", { class: "primary" }, t`Use this key`),
      async (form) => storeKey(String(form.get("key")).trim()),
    );
    return answer !== null;
  })().finally(() => (asking = null));
  return asking;
}

/** Change or remove the stored key. */
export async function changeKey() {
  const field = h("input", { name: "key", type: "password", autocomplete: "off" });
  const shown = `${storedKey()?.slice(0, 8)}…`;
  const answer = await ask(
    t`API key`,
    [h("p", {}, t`This browser uses the key ${shown}`), h("label", {}, t`Another key`, field)],
    [
      h("button", { class: "primary", value: "use" }, t`Use this key`),
      h("button", { class: "danger", value: "remove" }, t`Remove the key`),
    ],
    async (form, chosen) => {
      const key = String(form.get("key")).trim();
      if (chosen === "use" && !key) throw new Error(t`Type a key, or remove the one that is stored.`);
      storeKey(chosen === "remove" ? null : key);
    },
  );
  if (answer) location.reload();
}

/** A button of the page's head that changes the key; hidden while there is none. */
export function keyButton() {
  const button = h("button", { type: "button", class: "key", "aria-label": t`API key`, onclick: changeKey }, t`Key`);
  const show = () => (button.hidden = !storedKey());
  addEventListener("keychange", show);
  show();
  return button;
}

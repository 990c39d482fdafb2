// The service as the page asks it, and the API key that it asks with.

import { Client } from "../../js/client.js";
import { ask, h } from "./dom.js";
import { heard, t } from "./text.js";

export { path } from "../../js/client.js";

const KEY = "rholoc-api-key";
const LOOK_MS = 2000;
const SERVICE = { key: storedKey, translate: heard };
const BASE = new URL("../../", import.meta.url);

/** The service; where the stored key is missing, not valid or not allowed to do something, the user is asked for another. */
export const rholoc = new Client(BASE, { ...SERVICE, onRefused: askForKey });

/** The service for what is as good without an answer: nobody is asked for a key. */
export const unasking = new Client(BASE, SERVICE);

/** The key that this window was opened with, or that is stored in this browser; or null. */
export function storedKey() {
  return sessionStorage.getItem(KEY) ?? localStorage.getItem(KEY);
}

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

/** GET as an object URL, for pictures; the caller revokes it. */
export async function objectUrl(where, options) {
  return URL.createObjectURL(await (await rholoc.request("GET", where, options)).blob());
}

/** Save what a GET answers under a name, as the browser saves downloads. */
export async function download(where, name, options) {
  const address = await objectUrl(where, options);
  h("a", { href: address, download: name }).click();
  setTimeout(() => URL.revokeObjectURL(address), 60_000);
}

/** Wait until the server answers again. */
export async function serverIsBack(signal) {
  for (;;) {
    await new Promise((resolve) => setTimeout(resolve, LOOK_MS));
    signal.throwIfAborted();
    try {
      return void (await unasking.get("v1/maps", { signal }));
    } catch (error) {
      if (error.name === "AbortError") throw error;
      if (!error.passes) return;
    }
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
          t`It is kept in this browser.`,
          " ",
          error.status === 403 ? error.hint : t`Whoever runs the server makes one: rholoc key create NAME --scope map`,
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
  const button = h("button", { type: "button", class: "key", onclick: changeKey }, t`My key`);
  const show = () => (button.hidden = !storedKey());
  addEventListener("keychange", show);
  show();
  return button;
}

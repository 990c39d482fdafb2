// Links with a key in them that expires: to go on with a phone, to show somebody a map.

import { rholoc } from "./api.js";
import { h } from "./dom.js";
import { t } from "./text.js";

/** What a key is handed on for. */
export const Purpose = Object.freeze({ RECORD: "map", LOOK: "read", VISIT: "visit" });

/**
 * A link to a page of this server, `where` with its part behind the `#`, with a key of its own where the server asks for
 * keys: `{link, expires}`, the time in seconds since the epoch or null. `wanted` is what `POST /v1/keys` takes.
 */
export async function linkWithKey(where, wanted) {
  const { key, expires } = await rholoc.call("POST", "v1/keys", { body: wanted });
  const address = new URL(where, new URL("../../", import.meta.url));
  if (key) address.hash = `#/key/${key}${address.hash.slice(1)}`;
  return { link: address.href, expires };
}

/** A link as a picture that a phone's camera opens. */
export async function qrCode(link) {
  const answer = await rholoc.request("POST", "v1/qr", { body: { text: link } });
  const address = URL.createObjectURL(await answer.blob());
  const picture = h("img", { class: "qr", src: address, alt: t`QR code of the link` });
  picture.addEventListener("load", () => URL.revokeObjectURL(address), { once: true });
  return picture;
}

/** Whether another device can reach this server by the address that this page has. */
export const isReachable = () => !/^(localhost|127\.|\[::1\])/.test(location.hostname);

// A link to a map for somebody without a key: to look at it, for a while.

import { action, ask, fill, h, tell } from "../shared/dom.js";
import { isReachable, linkWithKey, Purpose, qrCode } from "../shared/handover.js";
import { field } from "../shared/name_choice.js";
import { t } from "../shared/text.js";
import { when } from "./format.js";

const DAY_S = 86400;

/** Ask for how long somebody may look at a map, and show the link. */
export const share = (name) =>
  shareLink(
    t`Share a link`,
    t`Whoever has the link can look at all maps of this server until it expires, and change nothing.`,
    `#/maps/${encodeURIComponent(name)}`,
    { scope: Purpose.LOOK },
  );

/** Ask for how long a link to a page is to be valid, and show it, with a key for what it is handed on for. */
export async function shareLink(title, text, where, key) {
  const days = h(
    "select",
    {},
    [1, 7, 31].map((count) => h("option", { value: count }, count === 1 ? t`one day` : t`${count} days`)),
  );
  const place = h("div", { class: "stack" });
  const done = await ask(
    title,
    [h("p", { class: "muted" }, text), field(t`Valid for`, days)],
    h("button", { class: "primary" }, t`Make the link`),
    async () => showLink(place, await linkWithKey(where, { ...key, lifetime_s: days.value * DAY_S })),
  );
  if (done) await ask(title, place);
}

async function showLink(place, { link, expires }) {
  const text = h("input", { readonly: true, value: link, "aria-label": t`Link` });
  fill(
    place,
    !isReachable() &&
      h("p", { class: "notice warn" }, t`This address leads others nowhere: the server listens on this machine alone.`),
    h(
      "div",
      { class: "row" },
      text,
      action(t`Copy`, () => copy(link)),
    ),
    await qrCode(link),
    h(
      "p",
      { class: "small muted" },
      expires ? t`Valid until ${when(expires)}.` : t`This server needs no key: the link does not expire.`,
    ),
  );
}

async function copy(link) {
  await navigator.clipboard.writeText(link);
  tell(t`Copied.`);
}

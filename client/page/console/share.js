// A link to a map for somebody without a key: to look at it, for a while.

import { action, ask, fill, h, tell } from "../shared/dom.js";
import { isReachable, linkWithKey, Purpose, qrCode } from "../shared/handover.js";
import { field } from "../shared/name_choice.js";
import { t } from "../shared/text.js";
import { when } from "./format.js";

const DAY_S = 86400;

/** Ask for how long, and show the link. */
export async function share(name) {
  const days = h(
    "select",
    {},
    [1, 7, 31].map((count) => h("option", { value: count }, count === 1 ? t`one day` : t`${count} days`)),
  );
  const place = h("div", { class: "stack" });
  const done = await ask(
    t`Share a link`,
    [
      h(
        "p",
        { class: "muted" },
        t`Whoever has the link can look at all maps of this server until it expires, and change nothing.`,
      ),
      field(t`Valid for`, days),
    ],
    h("button", { class: "primary" }, t`Make the link`),
    async () => {
      const where = `#/maps/${encodeURIComponent(name)}`;
      await showLink(place, await linkWithKey(where, Purpose.LOOK, days.value * DAY_S));
    },
  );
  if (done) await ask(t`Share a link`, place, h("button", { class: "primary" }, t`Done`));
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

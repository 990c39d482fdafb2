// On a computer: the recorder's address for a phone, as a QR code.

import { busy, fill, h } from "../../shared/dom.js";
import { isReachable, linkWithKey, Purpose, qrCode } from "../../shared/handover.js";
import { t } from "../../shared/text.js";

const GOOD_FOR_S = 2 * 3600;

/** A card with the way to the phone; null on a device that is held in the hand. */
export function onPhone() {
  if (!matchMedia("(pointer: fine) and (hover: hover)").matches) return null;
  const place = h("div", { class: "stack" });
  const show = h("button", { type: "button", onclick: () => busy(show, showCode) }, t`Show a QR code`);

  async function showCode() {
    try {
      const { link, expires } = await linkWithKey(`record${location.hash || "#/"}`, {
        scope: Purpose.RECORD,
        lifetime_s: GOOD_FOR_S,
      });
      const good = expires
        ? t`Point the phone's camera at it. The key in it is valid for two hours.`
        : t`Point the phone's camera at it.`;
      fill(place, await qrCode(link), h("p", { class: "small muted" }, good));
      show.hidden = true;
    } catch (error) {
      fill(place, h("p", { class: "notice bad", role: "alert" }, error.message));
    }
  }

  return h(
    "section",
    { class: "card stack" },
    h("h2", {}, t`Go on with a phone`),
    h("p", {}, t`A walk is recorded with a phone: this computer's camera does not walk.`),
    isReachable() && window.isSecureContext
      ? show
      : [
          h("p", {}, t`Film the walk with the phone's camera app, and upload the video here.`),
          h("div", { class: "row" }, h("a", { class: "button", href: "./#/recordings" }, t`Upload a walk`)),
          h(
            "p",
            { class: "small muted" },
            t`To record in the phone's browser, with its motion sensors, start the server with rholoc serve --tls, and open the address that it prints here: it shows a QR code for the phone.`,
          ),
        ],
    place,
  );
}

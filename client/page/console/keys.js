// API keys: who may do what, how much, and until when.

import { path, rholoc } from "../shared/api.js";
import { action, ask, fill, h } from "../shared/dom.js";
import { field } from "../shared/name_choice.js";
import { t } from "../shared/text.js";
import { bytes, when } from "./format.js";
import { empty, loading, page, skeletons } from "./parts.js";

const DAY_S = 86400;
const SCOPES = [
  ["visit", t`find the way in a site`],
  ["read", t`look at everything`],
  ["localize", t`ask for poses, too`],
  ["map", t`make and change maps, too`],
  ["admin", t`everything`],
];
const LIMITS = [
  ["requests_per_s", t`Requests a second`],
  ["maps", t`Maps`],
  ["stored_bytes", t`Bytes stored`],
  ["jobs", t`Jobs at once`],
];

export async function showKeys(main, _, signal) {
  const list = h("ul", { class: "cards", "aria-label": t`Keys` }, skeletons(3, "camera-card"));
  const reload = () =>
    loading(list, async () => fillKeys(list, (await rholoc.get("v1/keys", { signal })).keys, reload), signal);
  fill(
    main,
    page(
      t`Keys`,
      action(t`New key`, () => handOn(reload), "primary"),
      h(
        "p",
        { class: "muted" },
        t`Keys without an end are made on the server, with rholoc key create. Those that are made here expire.`,
      ),
      list,
    ),
  );
  await reload();
}

function fillKeys(list, keys, reload) {
  if (!keys.length) {
    const text = t`This server asks nobody for a key, or has given out none.`;
    fill(list, h("li", { class: "whole-row" }, empty(t`No keys yet`, text)));
    return;
  }
  fill(
    list,
    keys.map((key) => keyCard(key, reload)),
  );
}

function keyCard(key, reload) {
  const limits = LIMITS.filter(([name]) => key.limits[name] !== null);
  const over = key.expires !== null && key.expires * 1000 < Date.now();
  return h(
    "li",
    { class: "card stack" },
    h("h2", {}, key.name),
    h(
      "p",
      {},
      h("span", { class: ["badge", over && "warn"] }, over ? t`expired` : key.scope),
      " ",
      SCOPES.find(([scope]) => scope === key.scope)?.[1],
      key.site && t` of ${key.site}`,
    ),
    h(
      "p",
      { class: "muted small" },
      key.expires === null ? t`Without an end` : t`Until ${when(key.expires)}`,
      key.handed_on_by && t`, handed on by ${key.handed_on_by}`,
    ),
    limits.length > 0 &&
      h("p", { class: "small" }, limits.map(([name, text]) => `${text}: ${shown(name, key.limits[name])}`).join(" · ")),
    h(
      "div",
      { class: "row" },
      action(t`Limits`, () => limit(key, reload)),
      action(t`Revoke`, () => revoke(key, reload), "danger"),
    ),
  );
}

const shown = (name, value) => (name === "stored_bytes" ? bytes(value) : String(value));

async function limit({ name, limits }, reload) {
  const { used } = await rholoc.get(path`v1/keys/${name}`);
  const done = await ask(
    t`Limits of ${name}`,
    [
      h("p", { class: "muted" }, t`It holds ${used.maps} maps, ${bytes(used.stored_bytes)} and ${used.jobs} jobs.`),
      h(
        "div",
        { class: "form" },
        LIMITS.map(([key, text]) => field(text, numberInput(key, limits[key]), t`empty: no limit`)),
      ),
    ],
    h("button", { class: "primary" }, t`Save`),
    (form) => {
      const entries = LIMITS.map(([key]) => [key, form.get(key) === "" ? null : Number(form.get(key))]);
      return rholoc.call("PUT", path`v1/keys/${name}/limits`, { body: { ...limits, ...Object.fromEntries(entries) } });
    },
  );
  if (done) await reload();
}

const numberInput = (name, value) => h("input", { name, type: "number", min: 0, step: "any", value: value ?? "" });

async function revoke({ name }, reload) {
  const done = await ask(
    t`Revoke the key?`,
    h("p", {}, t`${name}, and all keys that it handed on, are refused from now on.`),
    h("button", { class: "danger primary" }, t`Revoke`),
    () => rholoc.call("DELETE", path`v1/keys/${name}`),
  );
  if (done) await reload();
}

async function handOn(reload) {
  const scope = h(
    "select",
    { name: "scope" },
    SCOPES.slice(1).map(([value, text]) => h("option", { value }, text)),
  );
  const name = h("input", { name: "name", maxlength: 50, placeholder: "robot-7" });
  const days = h("input", { name: "days", type: "number", min: 1, max: 31, value: 1, required: true });
  /** @type {any} */
  let made = null;
  const done = await ask(
    t`New key`,
    [field(t`For whom or what`, name), field(t`It may`, scope), field(t`Days`, days)],
    h("button", { class: "primary" }, t`Make the key`),
    async (form) => {
      made = await rholoc.call("POST", "v1/keys", {
        body: { name: name.value || null, scope: form.get("scope"), lifetime_s: Number(form.get("days")) * DAY_S },
      });
    },
  );
  if (!done) return;
  const text = made.key
    ? h("input", { readonly: true, value: made.key, "aria-label": t`Key` })
    : h("p", {}, t`This server needs no key.`);
  await ask(t`New key`, [text, made.key && h("p", { class: "muted" }, t`It is not shown again.`)]);
  await reload();
}

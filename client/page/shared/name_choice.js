// A map's name, and what is to happen where there is a map of that name.

import { h } from "./dom.js";
import { t } from "./text.js";

const MOST_LETTERS = 64; // of a name
const SPELT = { ä: "ae", ö: "oe", ü: "ue", ß: "ss", Ä: "Ae", Ö: "Oe", Ü: "Ue" };

/** What becomes of a map that has the name already. */
export const Existing = Object.freeze({ LEARN: "update", REPLACE: "build" });

/**
 * A field for a name and, once it is that of a map, the question what to do: nothing is chosen beforehand.
 *
 * `names` are those of the maps there are, `learns` says whether what is uploaded can be learned by one. Gives
 * `{element, input, value, kind, asked, suggest(name), know(names)}`; `changed` hears of each change.
 */
export function nameChoice({ names = [], learns = true, value = "", kind = null, changed = () => {} }) {
  const name = nameField(value);
  const choices = [
    learns && [Existing.LEARN, t`The map learns it, and keeps what it knows`],
    [Existing.REPLACE, t`The map is replaced; the one before can be restored`],
  ].filter(Boolean);
  const group = `existing-${crypto.randomUUID()}`;
  const radios = choices.map(([choice, text]) => {
    const radio = h("input", {
      type: "radio",
      name: group,
      value: choice,
      checked: choice === kind,
      onchange: () => changed(),
    });
    return { radio, label: h("label", { class: "check" }, radio, text) };
  });
  const free = h("button", { type: "button", onclick: () => suggest(chosen()) }, t`Use another name`);
  const legend = h("legend", {});
  const question = h(
    "fieldset",
    { class: "notice warn stack" },
    legend,
    radios.map(({ label }) => label),
    free,
  );

  const chosen = () => mapNameOf(name.value);

  function show() {
    const exists = names.includes(chosen());
    question.hidden = !exists;
    legend.textContent = t`There is a map ${chosen()}. What is to be done?`;
    for (const { radio } of radios) radio.required = exists;
  }

  let proposed = null; // until somebody types another name

  /** Propose a name that no map has. */
  function suggest(wanted) {
    proposed = wanted;
    const root = wanted.replace(/-\d+$/, "");
    let free = wanted;
    for (let number = 2; names.includes(free); number++) free = `${root}-${number}`;
    name.value = free;
    show();
    changed();
  }

  name.addEventListener("input", () => {
    proposed = null;
    show();
    changed();
  });
  show();
  return {
    element: h("div", { class: "stack" }, field(t`Name of the map`, name), question),
    input: name,
    get value() {
      return chosen();
    },
    /** What was chosen where there is such a map, else that a new one is built. */
    get kind() {
      if (!names.includes(chosen())) return Existing.REPLACE;
      return radios.find(({ radio }) => radio.checked)?.radio.value ?? null;
    },
    /** Whether there is such a map, so that a choice was needed. */
    get asked() {
      return names.includes(chosen());
    },
    suggest,
    know(all) {
      names = all;
      if (proposed === null) show();
      else suggest(proposed); // before it was known which names are taken
    },
  };
}

/** A field with its label. */
export function field(text, input, note) {
  return h("label", {}, text, input, note && h("span", { class: "small muted" }, note));
}

/** A title as a name that the service takes: "Büro, 2. Stock" → "Buero-2.-Stock". */
export function mapNameOf(title) {
  const plain = title
    .replace(/[äöüß]/gi, (one) => SPELT[one] ?? one)
    .normalize("NFKD")
    .replace(/\p{M}/gu, "");
  const joined = plain.replace(/[^A-Za-z0-9._-]+/g, "-").replace(/^[^A-Za-z0-9_]+|-+$/g, "");
  return joined.slice(0, MOST_LETTERS);
}

/** The field of a name: any title may be typed, and becomes a name once it is left. */
export function nameField(value = "") {
  const input = h("input", {
    name: "name",
    value,
    required: true,
    autocomplete: "off",
    autocapitalize: "none",
    spellcheck: "false",
    onchange: () => {
      input.value = mapNameOf(input.value);
      input.dispatchEvent(new Event("input"));
    },
  });
  return input;
}

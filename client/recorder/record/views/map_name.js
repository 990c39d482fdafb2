// The name of the map that a recording becomes.

import { h } from "../../shared/dom.js";

/** A labelled field for a map's name; `changed` hears of each that may be one. */
export function mapNameField(name, changed) {
  return h(
    "label",
    {},
    "Name of the map",
    h("input", {
      name: "map",
      value: name,
      required: true,
      maxlength: 64,
      pattern: "[A-Za-z0-9_][A-Za-z0-9._\\-]*",
      title: "Letters, digits, . _ and -, the first a letter, a digit or _",
      autocomplete: "off",
      autocapitalize: "none",
      spellcheck: "false",
      oninput: ({ target }) => target.checkValidity() && changed(target.value),
    }),
  );
}

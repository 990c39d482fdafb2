// Which of the cameras that the server knows a recording was made with.

import { unasking } from "../../shared/api.js";
import { fill, h } from "../../shared/dom.js";
import { t } from "../../shared/text.js";

/** A labelled choice, hidden where the server knows no camera or does not answer; `changed` hears a name, or null. */
export function cameraField(chosen, changed) {
  const select = h("select", { onchange: () => changed(select.value || null) });
  const field = h("label", { hidden: true }, t`Camera`, select);
  const names = unasking.get("v1/cameras").then(({ cameras }) => cameras.map(({ name }) => name));
  names
    .then((known) => {
      field.hidden = known.length === 0;
      fill(
        select,
        h("option", { value: "" }, t`Unknown: estimated while mapping`),
        known.map((name) => h("option", { value: name, selected: name === chosen }, name)),
      );
    })
    .catch(() => {}); // it stays hidden
  return field;
}

// Which of the cameras that the server knows a recording was made with.

import { authorization, url } from "../../shared/api.js";
import { fill, h } from "../../shared/dom.js";
import { t } from "../../shared/text.js";

/** A labelled choice, hidden where the server knows no camera or does not answer; `changed` hears a name, or null. */
export function cameraField(chosen, changed) {
  const select = h("select", { onchange: () => changed(select.value || null) });
  const field = h("label", { hidden: true }, t`Camera`, select);
  names().then((known) => {
    field.hidden = known.length === 0;
    fill(
      select,
      h("option", { value: "" }, t`Unknown: estimated while mapping`),
      known.map((name) => h("option", { value: name, selected: name === chosen }, name)),
    );
  });
  return field;
}

async function names() {
  try {
    const response = await fetch(url("v1/cameras"), { credentials: "omit", headers: authorization() });
    return response.ok ? (await response.json()).cameras.map((camera) => camera.name) : [];
  } catch {
    return [];
  }
}

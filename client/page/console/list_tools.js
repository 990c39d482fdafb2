// How a list is searched and sorted.

import { h } from "../shared/dom.js";
import { field } from "../shared/name_choice.js";
import { t } from "../shared/text.js";

/**
 * A field to search in and a choice of orders `[name, text, compare]`: `{element, chosen(items)}`. `textOf` gives what is
 * searched of an item; `changed` hears that the list is to be shown anew.
 */
export function listTools(orders, textOf, changed) {
  const search = h("input", { type: "search", oninput: changed, autocomplete: "off" });
  const order = h(
    "select",
    { onchange: changed },
    orders.map(([name, text]) => h("option", { value: name }, text)),
  );
  const chosen = (items) => {
    const [, , compare] = orders.find(([name]) => name === order.value);
    return items.filter((item) => matches(textOf(item), search.value)).sort(compare);
  };
  const element = h("div", { class: "row tools", role: "search" }, field(t`Search`, search), field(t`Order`, order));
  return { element, chosen };
}

/** Whether a text holds all words of a search, in any order and case. */
export function matches(text, search) {
  const within = text.toLowerCase();
  return search
    .toLowerCase()
    .split(/\s+/)
    .every((word) => within.includes(word));
}

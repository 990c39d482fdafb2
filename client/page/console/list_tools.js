// How a list is searched, sorted and grouped.

import { h } from "../shared/dom.js";
import { field } from "../shared/name_choice.js";
import { t } from "../shared/text.js";

/**
 * A field to search in, a choice of orders `[name, text, compare]`, and one of groups `[name, text, groupsOf]` of which an
 * item may be in several: `{element, chosen(items)}`, which gives `[{title, items}]`, the title null where nothing is
 * grouped. `textOf` gives what is searched of an item; `changed` hears that the list is to be shown anew.
 */
export function listTools({ orders, groups = [], textOf, changed }) {
  const search = h("input", { type: "search", oninput: changed, autocomplete: "off" });
  const order = choice(orders, changed);
  const group = choice([["", t`not at all`], ...groups], changed);
  const chosen = (items) => {
    const [, , compare] = orders.find(([name]) => name === order.value);
    const [, , groupsOf] = groups.find(([name]) => name === group.value) ?? [];
    const found = items.filter((item) => matches(textOf(item), search.value)).sort(compare);
    return grouped(found, groupsOf);
  };
  const element = h(
    "div",
    { class: "row tools", role: "search" },
    field(t`Search`, search),
    field(t`Order`, order),
    groups.length > 0 && field(t`Group`, group),
  );
  return { element, chosen };
}

const choice = (options, onchange) =>
  h(
    "select",
    { onchange },
    options.map(([name, text]) => h("option", { value: name }, text)),
  );

/**
 * Items by the groups that they are in, these by name and those of no group last: `[{title, items}]`.
 * @template T
 * @param {T[]} items
 * @param {((item: T) => string[]) | undefined} groupsOf
 * @returns {{title: string | null, items: T[]}[]}
 */
export function grouped(items, groupsOf) {
  if (!groupsOf) return [{ title: null, items }];
  const groups = new Map();
  for (const item of items) {
    const titles = groupsOf(item).filter(Boolean);
    for (const title of titles.length ? titles : [""]) groups.set(title, [...(groups.get(title) ?? []), item]);
  }
  const titles = [...groups.keys()].sort((a, b) => Number(!a) - Number(!b) || a.localeCompare(b));
  return titles.map((title) => ({ title: title || t`the others`, items: groups.get(title) }));
}

/** Whether a text holds all words of a search, in any order and case. */
export function matches(text, search) {
  const within = text.toLowerCase();
  return search
    .toLowerCase()
    .split(/\s+/)
    .every((word) => within.includes(word));
}

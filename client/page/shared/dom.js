// Elements without markup: every text is set as text, so that no name can ever be read as HTML.

import { t } from "./text.js";

/**
 * An element. `properties` are attributes, except: functions `on…` listen, `class` may be a list, false or null is left
 * out, true is an empty attribute. Children are elements, strings, numbers, or lists of them; null and false are skipped.
 */
export function h(tag, properties = {}, ...children) {
  const element = document.createElement(tag);
  for (const [name, value] of Object.entries(properties)) {
    if (value === null || value === undefined || value === false) continue;
    if (typeof value === "function") element.addEventListener(name.slice(2).toLowerCase(), value);
    else if (name === "class") element.className = [value].flat().filter(Boolean).join(" ");
    else if (name === "value") element.value = value;
    else element.setAttribute(name, value === true ? "" : value);
  }
  element.append(...nodes(children));
  return element;
}

/** Put children in place of what an element holds. */
export function fill(element, ...children) {
  element.replaceChildren(...nodes(children));
  return element;
}

function nodes(children) {
  return children
    .flat(Infinity)
    .filter((child) => child !== null && child !== undefined && child !== false)
    .map((child) => (child instanceof Node ? child : String(child)));
}

/** Work for a button, which does nothing else meanwhile, but keeps the focus: a disabled one would lose it. */
export async function busy(button, work) {
  if (button.ariaDisabled) return;
  button.ariaDisabled = "true";
  try {
    await work();
  } finally {
    button.ariaDisabled = null;
  }
}

/**
 * A dialog around `content`, opened, with a button to close it beside `buttons`; the promise gives what its form was submitted with (the value of the button), or
 * null when it was closed. `check` gets the form's data and that value, and may refuse by throwing; its message is shown
 * in the dialog. Where something would be lost, the button that keeps it has the focus.
 * @param {string} title
 * @param {any} content
 * @param {any} [buttons] null where there is nothing to do but to read
 * @param {(form: FormData, chosen?: string) => Promise<any>} check
 */
export function ask(title, content, buttons = null, check = async () => {}) {
  const problem = h("p", { class: "notice bad", role: "alert", hidden: true });
  const losing = [buttons].flat().every((button) => button?.classList.contains("danger"));
  const cancel = h(
    "button",
    { type: "button", class: !buttons && "primary", autofocus: losing, onclick: () => dialog.close() },
    buttons ? t`Cancel` : t`Done`,
  );
  const form = h(
    "form",
    { class: "stack", method: "dialog" },
    h("h2", {}, title),
    content,
    problem,
    h("div", { class: "row" }, buttons, cancel),
  );
  const dialog = h("dialog", { "aria-label": title }, form);
  return new Promise((resolve) => {
    let answer = null;
    form.addEventListener("submit", (event) => {
      event.preventDefault();
      const chosen = event.submitter ?? form;
      busy(chosen, async () => {
        try {
          await check(new FormData(form), chosen.value);
          answer = chosen.value || "ok";
          dialog.close();
        } catch (error) {
          problem.textContent = String(error.message ?? error);
          problem.hidden = false;
        }
      });
    });
    dialog.addEventListener("close", () => {
      dialog.remove();
      resolve(answer);
    });
    document.body.append(dialog);
    dialog.showModal();
  });
}

/** A line at the bottom of the window that says what was done, and goes away. */
export function tell(text, kind = "good") {
  document.querySelector(".toast")?.remove();
  const toast = h("div", { class: ["toast notice", kind], role: "status" }, text);
  document.body.append(toast);
  setTimeout(() => toast.remove(), 6000);
}

/** A button that works on something: it waits, keeping the focus, and shows an error. */
export function action(text, work, kind = "") {
  const button = h("button", { type: "button", class: kind }, text);
  button.addEventListener("click", () =>
    busy(button, async () => {
      try {
        await work();
      } catch (error) {
        if (error.name !== "AbortError") tell(error.message, "bad");
      }
    }),
  );
  return button;
}

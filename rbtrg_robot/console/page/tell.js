// Small helpers for text on the page. Nothing that comes from the robot is ever taken for markup.

export const $ = (id) => document.getElementById(id);
export const figure = (value, digits = 2) =>
  value === null || value === undefined
    ? "unknown"
    : Number(value)
        .toFixed(digits)
        .replace(/^-(0\.?0*)$/, "$1");
export const degrees = (radians) => (radians * 180) / Math.PI;

// What stands in a field; null where nothing does.
export function number(id) {
  const words = $(id).value.trim().replace(",", ".");
  return words === "" ? null : Number(words);
}

export function put(id, words) {
  const at = $(id);
  if (at.textContent !== words) at.textContent = words;
}

export function list(at, rows) {
  at.replaceChildren(
    ...rows.flatMap(([term, words, style]) => {
      const dt = document.createElement("dt"),
        dd = document.createElement("dd");
      dt.textContent = term;
      dd.textContent = words;
      if (style) dd.className = style;
      return [dt, dd];
    }),
  );
}

// rows: cells are text, [text, class], or an element.
export function table(at, titles, rows) {
  const make = (name, cell) => {
    const made = document.createElement(name);
    if (cell instanceof Node) made.append(cell);
    else if (Array.isArray(cell)) [made.textContent, made.className] = cell;
    else made.textContent = cell;
    return made;
  };
  const line = (name, cells) => {
    const tr = document.createElement("tr");
    tr.append(...cells.map((cell) => make(name, cell)));
    return tr;
  };
  const head = document.createElement("thead"),
    body = document.createElement("tbody");
  head.append(line("th", titles));
  for (const empty of head.querySelectorAll("th:empty")) empty.outerHTML = "<td></td>"; // it is the head of nothing
  body.append(...rows.map((cells) => line("td", cells)));
  if (!rows.length) body.append(line("td", ["none yet"]));
  if (!rows.length) body.rows[0].cells[0].colSpan = Math.max(1, titles.length);
  at.replaceChildren(...[at.caption, head, body].filter(Boolean));
  return rows.length ? [...body.rows] : [];
}

export function button(words, press) {
  const made = document.createElement("button");
  made.type = "button";
  made.textContent = words;
  made.onclick = press;
  return made;
}
export function anchor(words, href) {
  const made = document.createElement("a");
  made.textContent = words;
  made.href = href;
  made.download = "";
  return made;
}

// What the server has on its disk. Throws its words where it refuses.
export async function get(path, options) {
  const answer = await fetch(path, options);
  const found = await answer.json();
  if (!answer.ok) throw new Error(found.words ?? answer.statusText);
  return found;
}
export const post = (path, content) => get(path, { method: "POST", body: JSON.stringify(content ?? {}) });

// A press that must be meant is pressed twice. No dialog of the browser: it would keep the STOP keys from the page.
export function twice(made, words, act) {
  const before = made.textContent;
  let armed = 0;
  const calm = () => {
    clearTimeout(armed);
    armed = 0;
    made.textContent = before;
    made.classList.remove("armed");
  };
  made.onclick = () => {
    if (armed) {
      calm();
      return act();
    }
    made.textContent = words();
    made.classList.add("armed");
    armed = setTimeout(calm, 5000);
  };
}

// What happened, the newest first: a press leads to its place on the ground, or to the log at that instant.
import { $, button } from "./tell.js";

const BEFORE = 5; // seconds that a replay begins before what happened

export function makeEvents(link, view, about, free, archive) {
  let shown = "";
  const time = (seconds) => new Date(1000 * seconds).toLocaleTimeString([], { hour12: false });

  function row({ logged, severity, text, who, place }) {
    const made = document.createElement("li"),
      words = document.createElement("p"),
      at = document.createElement("time"),
      acts = document.createElement("span");
    at.textContent = time(logged);
    at.dateTime = new Date(1000 * logged).toISOString();
    words.append(at, ` ${text}`, who ? `, by ${who}` : "");
    words.className = { warning: "word-warn", error: "word-bad" }[severity] ?? "";
    acts.className = "row";
    if (place)
      acts.append(
        button("Place", () => {
          view.world.mark = { x: place[0], y: place[1] };
          view.look(...place);
          $("scene").scrollIntoView({ block: "nearest" });
        }),
      );
    if (link.replay || about.run)
      acts.append(button("Log", () => archive.at(link.replay || about.run, logged - BEFORE)));
    for (const act of acts.children) act.setAttribute("aria-label", `${act.textContent} of: ${text}`);
    made.append(words, acts);
    return made;
  }
  function show() {
    const { events } = link.newest.events ?? { events: [] };
    if ($("events").hidden || shown === `${link.replay} ${events.at(-1)?.number}`) return;
    shown = `${link.replay} ${events.at(-1)?.number}`;
    $("event-list").replaceChildren(...events.toReversed().map(row));
    $("event-none").hidden = !!events.length;
  }
  link.on("events", show);
  return { show };
}

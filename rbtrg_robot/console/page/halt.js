// STOP: before everything else on this page, and without it.
import { $ } from "./tell.js";

export function makeHalt(link) {
  const halt = $("halt");
  halt.addEventListener("pointerdown", (event) => {
    event.preventDefault();
    link.halt();
  });
  halt.addEventListener("click", (event) => {
    if (event.detail === 0) link.halt();
  }); // Enter, or a screen reader
  const typing = (event) => /^(INPUT|TEXTAREA|SELECT)$/.test(event.target.tagName ?? "");
  for (const kind of ["keydown", "keyup"]) {
    document.addEventListener(
      kind,
      (event) => {
        if (event.code !== "Escape" && !(event.code === "Space" && !typing(event))) return;
        event.preventDefault();
        event.stopPropagation();
        if (kind === "keydown" && !event.repeat) link.halt();
      },
      true,
    );
  }
  // Of a stop that was released nothing stays here; the line on top tells what is.
  link.on("halt", ({ state, words }) => {
    const at = $("stop-said");
    at.className = state === "confirmed" ? "good" : state === "unconfirmed" ? "bad" : "";
    if (at.textContent !== words) at.textContent = words;
  });
}

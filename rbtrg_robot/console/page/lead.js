// A re-run that is led step by step: how far it is, what a stage knows there, and why not there.
import { readPlan } from "./drive.js";
import { $, figure, list, number, put } from "./tell.js";

export function makeLead(link, view, about, free) {
  const { world } = view;
  let place = null, // x, y that was pressed, in map
    asked = 0;

  $("lead-tab").hidden = false;
  for (const id of ["stopbar", "replay-end"]) $(id).hidden = true; // there is no robot
  for (const name of about.step) $("lead-stage").append(new Option(name, name));

  async function wish(content) {
    const answer = await link.wish(content).catch((error) => ({ ok: false, words: error.message }));
    if (!answer.ok && !answer.found) free.say(answer.words, "bad");
    return answer;
  }
  async function look() {
    const mine = ++asked;
    const { found } = await wish({ do: "inside", stage: $("lead-stage").value, ...place });
    if (!found || mine !== asked) return;
    for (const [id, rows] of [
      ["lead-in", found.inputs],
      ["lead-out", found.outputs],
      ["lead-inside", found.inside],
      ["lead-place", found.place],
    ])
      list($(id), rows);
  }
  async function go(content) {
    const made = ["lead-message", "lead-scan"].map($);
    for (const each of made) each.disabled = true;
    await wish({ do: "step", ...content });
    for (const each of made) each.disabled = false;
    await look();
  }
  async function pick(x, y) {
    place = { x, y };
    world.goal = { x, y, yaw: null };
    put("lead-why", "Asking the planner…");
    const answer = await wish({ do: "ask", x, y, graph: true });
    world.preview = world.shown = answer.ok ? readPlan(answer.found) : null;
    put(
      "lead-why",
      answer.ok
        ? `A way leads ${answer.found.reaches_goal ? "there" : "to the edge of what is seen"}: ${figure(answer.found.length, 1)} m at a cost of ${figure(answer.found.cost, 1)} m. ${answer.found.chance}`
        : `Not there: ${answer.words}`,
    );
    view.show();
    await look();
  }
  $("lead-message").onclick = () => go({ what: "message" });
  $("lead-scan").onclick = () => go({ what: "scan" });
  $("lead-form").onsubmit = (event) => {
    event.preventDefault();
    go({ what: "seek", seconds: number("lead-to") });
  };
  $("lead-stage").onchange = look;
  link.on("replay", ({ seconds, length, last, paused }) =>
    put("lead-said", `${figure(seconds, 3)} s of ${figure(length, 1)} s${last ? `, after ${last}` : ""}${paused ? "" : ", running"}`),
  );
  return { pick };
}

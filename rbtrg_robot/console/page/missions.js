// Missions: the files, the steps on the ground, how far the robot is, and the answer to what it asks.
import { $, button, figure, get, post, put, table, twice } from "./tell.js";

const STATUS = {
  WAITING: "",
  INITIALIZING: "begins",
  RUNNING: "now",
  PAUSED: "paused",
  FINISHED: "done",
  FAILED: "failed",
};
const ACTIVE = ["running", "holding", "paused"];

export function makeMissions(link, view, free) {
  const { world } = view;
  let file = null,
    asked = "",
    before = []; // places of the file's steps that were moved, for undo

  const tell = (content) => free.tell({ do: "mission", ...content });
  const present = () => {
    const { mission, mission_order: order } = link.newest;
    return mission?.order_id && order?.order_id === mission.order_id ? { ...order, ...mission } : null;
  };
  const active = () => ACTIVE.includes(link.newest.mission?.phase);

  // --- the mission that is under way ------------------------------------------------------------------------
  function show() {
    const { mission } = link.newest,
      now = present();
    world.mission = file ?? (active() ? now : null);
    view.show();
    if (!mission) return;
    const asks = mission.question ? `${mission.order_id} ${mission.step} ${mission.question}` : "";
    if (asks !== asked) {
      asked = asks;
      put("question-words", mission.question);
      $("choices").replaceChildren(
        ...mission.choices.map((words) =>
          button(words, () =>
            tell({
              what: "answer",
              answer: words,
              step: link.newest.mission.step,
              order_id: link.newest.mission.order_id,
            }),
          ),
        ),
      );
      $("question").hidden = !asks;
      if (asks) $("question").scrollIntoView({ block: "nearest" });
      document.querySelector("nav [data-view=missions]").classList.toggle("asks", !!asks);
    }
    put("mission-said", mission.words[0].toUpperCase() + mission.words.slice(1));
    $("mission-acts").hidden = !active();
    const done = mission.action_status.filter((word) => word === "FINISHED").length;
    $("mission-done").hidden = !mission.order_id;
    $("mission-done").max = Math.max(1, mission.action_status.length);
    $("mission-done").value = mission.phase === "finished" ? $("mission-done").max : done;
    if (now && !$("missions").hidden)
      steps(
        "mission-steps",
        now,
        (k) => [[STATUS[mission.action_status[k]] + (mission.results[k] ? `: ${mission.results[k]}` : ""), "wrap"]],
        active() ? mission.step - 1 : -1,
      );
    lock();
  }
  function steps(id, order, more, at) {
    const rows = table(
      $(id),
      ["#", ["step", "text"], ...(more ? [["", "text"]] : [])],
      order.steps.map((step, k) => [
        step.x === undefined ? String(k + 1) : button(String(k + 1), () => view.look(step.x, step.y)),
        [step.words, "wrap"],
        ...(more?.(k) ?? []),
      ]),
    );
    rows.forEach((row, k) => {
      row.classList.toggle("chosen", k === at);
      if (order.steps[k].x !== undefined)
        row.firstChild.firstChild.setAttribute("aria-label", `Show step ${k + 1} on the ground`);
    });
  }
  for (const made of document.querySelectorAll("[data-mission]")) {
    const what = made.dataset.mission;
    const act = () =>
      tell({ what, order_id: link.newest.mission.order_id, step: what === "skip" ? link.newest.mission.step : 0 });
    if (what === "stop") twice(made, () => "It cannot be resumed. Really end it?", act);
    else made.onclick = act;
  }

  // --- files ------------------------------------------------------------------------------------------------
  async function files() {
    const { folder, missions } = await get("/missions");
    put(
      "mission-folder",
      missions.length
        ? `In ${folder}.`
        : `No mission files in ${folder}. \`rbtrg-robot mission record\` makes one from a drive.`,
    );
    table(
      $("mission-files"),
      missions.length ? ["", ["mission", "text"], "steps"] : [],
      missions.map((row) => [
        row.wrong ? "" : button("Look", () => look(row.file).catch(say)),
        [row.wrong || (row.name ? `${row.name} (${row.file})` : row.file), row.wrong ? "wrap word-bad" : "wrap"],
        row.wrong ? "" : String(row.steps),
      ]),
    );
  }
  async function look(name) {
    const order = await get(`/missions/${encodeURIComponent(name)}`);
    file = { ...order, file: name, action_status: [], step: 0 };
    $("file-card").hidden = false;
    put("file-name", name);
    const loops = order.loops.map(
      ([first, last, times]) => `steps ${first} to ${last}, ${times ? `${times} times` : "for ever"}`,
    );
    const loss = {
      "": "without an operator in contact it does what comms.on_loss of the stack says",
      continue: "goes on without an operator in contact",
      hold: "stands without an operator in contact",
      return: "drives home without an operator in contact",
    }[order.on_comms_loss];
    put(
      "file-facts",
      [loss + (order.comms_timeout ? ` for ${figure(order.comms_timeout, 0)} s` : ""), ...loops].join("; "),
    );
    before = [];
    $("file-as").value = name.replace(/\.ya?ml$/, "-moved");
    listed();
    $("file-from").replaceChildren(...order.steps.map((_, k) => new Option(String(k + 1))));
    const first = order.steps.find((step) => step.x !== undefined);
    if (first) view.look(first.x, first.y);
    $("file-card").scrollIntoView({ block: "nearest" });
    lock();
    show();
  }
  // --- its places, moved by hand ----------------------------------------------------------------------------
  const moved = () => file.steps.flatMap((step, k) => (step.moved ? [[k + 1, step.x, step.y]] : []));
  function listed() {
    steps("file-steps", file, null, -1);
    $("file-form").hidden = !before.length && !moved().length;
    $("file-undo").disabled = !before.length;
    const many = moved().length;
    put("file-moved", many ? `${many} moved; the file is as it was.` : "Drag a step on the ground to move it.");
  }
  function putAt(step, { x, y, moved: apart }) {
    Object.assign(step, { x, y, moved: apart });
    step.words = step.words.replace(/^goto \S+ \S+/, `goto ${figure(step.x)} ${figure(step.y)}`);
    show();
  }
  // What goes with a finger that presses here: a step of the file that is looked at.
  function grab(x, y) {
    if (!file || $("missions").hidden) return null;
    const near = 0.04 * view.camera.distance; // metres: a finger's width
    const away = (step) => (step.x === undefined ? Infinity : Math.hypot(step.x - x, step.y - y));
    const step = file.steps.reduce((best, other) => (away(other) < away(best) ? other : best));
    if (!(away(step) <= near)) return null;
    const was = { x: step.x, y: step.y, moved: step.moved };
    return (to, end) => {
      putAt(step, to ? { x: to[0], y: to[1], moved: true } : was);
      if (!end) return;
      if (to) before.push({ step, was });
      listed();
    };
  }
  function undo() {
    const last = before.pop();
    if (!last) return;
    putAt(last.step, last.was);
    listed();
  }
  $("file-undo").onclick = undo;
  addEventListener("keydown", (event) => {
    if (event.key !== "z" || !(event.ctrlKey || event.metaKey) || event.target.closest?.("input")) return;
    if (!file || $("missions").hidden) return;
    event.preventDefault();
    undo();
  });
  $("file-form").onsubmit = async (event) => {
    event.preventDefault();
    const name = `${$("file-as").value}.yaml`;
    try {
      const { words } = await post(`/missions/${encodeURIComponent(name)}`, { file: file.file, moved: moved() });
      await files();
      await look(name);
      put("file-moved", words);
    } catch (error) {
      put("file-moved", `Not saved: ${error.message}`);
    }
  };
  function clear() {
    file = null;
    $("file-card").hidden = true;
    show();
  }
  $("file-clear").onclick = clear;
  $("file-run").onclick = async () => {
    const answer = await tell({
      what: "run",
      file: file.file,
      step: Number($("file-from").value),
      moved: moved(),
    });
    if (!answer.ok) return;
    clear();
    view.chase();
  };
  const say = (error) => free.say(error.message, "bad");
  $("reload-missions").onclick = () => files().catch(say);

  function lock() {
    const locked = link.fresh === "stale" || !free.operating(),
      { phase } = link.newest.mission ?? {};
    for (const made of document.querySelectorAll("#choices button, #file-run, #file-form [type=submit]")) made.disabled = locked;
    for (const made of document.querySelectorAll("[data-mission]"))
      made.disabled =
        (locked && made.dataset.mission !== "pause") ||
        (made.dataset.mission === "resume" && phase !== "paused") ||
        (made.dataset.mission === "pause" && (!free.operating() || phase === "paused"));
    $("file-run").disabled ||= active();
  }
  link.on("mission", show);
  link.on("mission_order", show);
  return {
    grab,
    lock,
    show: () => {
      show();
      return files().catch(say);
    },
  };
}

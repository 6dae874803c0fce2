// The robot in words, the goal, and what would become of it.
import { ACTIVE } from "./state.js";
import { $, button, degrees, figure, list, number, put, twice } from "./tell.js";

export function makeDrive(link, view, about, free) {
  const { world } = view;
  let asked = 0;

  // --- the robot ------------------------------------------------------------------------------------------
  function showRobot() {
    const { robot, pose, odometry, map } = link.newest;
    if (!robot) return;
    const rows = [["Battery", robot.battery === null ? "unknown" : `${Math.round(robot.battery * 100)} %`]];
    if (pose)
      rows.unshift(
        ["Place", `x ${figure(pose.x)} y ${figure(pose.y)} m, heading ${figure(degrees(pose.yaw), 0)}°`],
        ["Speed", `${figure(pose.v)} m/s, ${figure(pose.w)} rad/s`],
      );
    if (odometry)
      rows.push([
        "Localization",
        odometry.health + (odometry.reason ? `: ${odometry.reason}` : ""),
        odometry.health === "good" ? "word-good" : "word-bad",
      ]);
    if (map?.warning) rows.push(["Map", map.warning, "word-warn"]);
    list($("figures"), rows);
  }
  for (const made of document.querySelectorAll("[data-posture]")) {
    const act = () => free.tell({ do: "posture", what: made.dataset.posture });
    if (made.dataset.posture === "damp") twice(made, () => "It sinks to the ground. Really?", act);
    else made.onclick = act;
  }

  // --- the goal -------------------------------------------------------------------------------------------
  for (const [name, [x, y, yaw]] of Object.entries(about.goals))
    $("names").append(button(name, () => choose(x, y, yaw)));
  const home = button("Robot's home", () => choose(world.home.x, world.home.y, world.home.yaw));
  home.hidden = true;
  $("names").append(home);

  function wanted() {
    const [x, y, yaw] = [number("gx"), number("gy"), number("gyaw")];
    if (x === null || y === null || [x, y, yaw ?? 0].some((v) => !Number.isFinite(v))) return null;
    return { x, y, yaw: yaw === null ? null : (yaw * Math.PI) / 180 };
  }
  function choose(x, y, yaw) {
    $("gx").value = figure(x);
    $("gy").value = figure(y);
    $("gyaw").value = yaw === null || yaw === undefined ? "" : figure(degrees(yaw), 0);
    ask();
  }
  async function ask() {
    const goal = wanted(),
      mine = ++asked;
    forget(false);
    if (!goal) return verdict("A goal is x and y in metres.", false);
    world.goal = goal;
    $("clear").hidden = false;
    view.show();
    verdict("Asking the planner…");
    let answer;
    try {
      answer = await link.wish({ do: "ask", ...goal });
    } catch (error) {
      answer = { ok: false, words: error.message };
    }
    if (mine !== asked) return;
    world.goal = goal; // the robot has told of its own one meanwhile
    if (!answer.ok) {
      const why = document.createElement("a");
      why.textContent = "What to do";
      why.href = "/docs/operate/troubleshooting.md#a-goal-is-refused-or-given-up";
      why.target = "_blank";
      why.rel = "noopener";
      return verdict(`It would not go: ${answer.words} `, false).append(why);
    }
    const plan = readPlan(answer.found);
    world.preview = plan;
    world.shown = plan;
    world.chosen = null;
    const risky = plan.p_fail > about.accept_risk;
    const end = plan.reaches_goal
      ? "It would go."
      : "It would go to the edge of what is seen, and look again from there.";
    const box = verdict(risky ? "It may well fail, and would not go by itself." : end, !risky);
    for (const line of lines_of(plan)) {
      const made = document.createElement("p");
      made.textContent = line;
      box.append(made);
    }
    const go = $(risky ? "accept" : "go");
    go.hidden = false;
    go.setAttribute(
      "aria-label",
      `${risky ? "Accept the risk and go" : "Go"} to x ${figure(goal.x)}, y ${figure(goal.y)}`,
    );
    go.scrollIntoView({ block: "nearest" });
    view.show();
    free.plan(plan, "preview");
  }
  function verdict(words, good) {
    const box = document.createElement("div");
    box.className = `verdict${good === false ? " no" : ""}`;
    const line = document.createElement("strong");
    line.textContent = words;
    box.append(line);
    $("answer").replaceChildren(box);
    return box;
  }
  function forget(all = true) {
    if (all) {
      asked++;
      world.goal = null;
      for (const id of ["gx", "gy", "gyaw"]) $(id).value = "";
      $("clear").hidden = true;
    }
    if (world.shown === world.preview) world.shown = world.route;
    world.preview = null;
    world.chosen = null;
    noGo();
    $("answer").replaceChildren();
    view.show();
  }
  $("goal").onsubmit = (event) => {
    event.preventDefault();
    ask();
  };
  $("clear").onclick = () => forget();
  for (const id of ["gx", "gy", "gyaw"])
    $(id).oninput = () => {
      noGo();
      $("answer").replaceChildren(); // what was asked for is not what stands there now
    };
  function noGo() {
    for (const id of ["go", "accept"]) $(id).hidden = true;
  }
  async function go(button, accept) {
    const goal = wanted();
    if (!goal) return;
    button.disabled = true;
    const answer = await free.tell({ do: "goal", accept, ...goal });
    button.disabled = locked();
    if (answer.ok) {
      forget(false);
      view.chase();
      $("scene").scrollIntoView({ block: "nearest" }); // on a phone it lies above: now the robot is what matters
    }
  }
  $("go").onclick = () => go($("go"), false);
  twice(
    $("accept"),
    () => "It may fall. Really?",
    () => go($("accept"), true),
  );

  const locked = () => !free.may();
  function lock() {
    for (const id of ["ask", "go", "accept"]) $(id).disabled = locked();
    for (const made of document.querySelectorAll("[data-posture], #names button")) made.disabled = locked();
  }

  link.on("robot", showRobot);
  link.on("goal", (goal) => {
    showRobot();
    if (!world.preview) world.goal = ACTIVE.includes(goal.state) ? goal : null;
    if (!world.goal && world.route) {
      world.route = null;
      free.plan(null);
    }
    view.show();
  });
  link.on("mission", (mission) => {
    home.hidden = !mission.home;
    if (JSON.stringify(world.home) === JSON.stringify(mission.home)) return;
    world.home = mission.home;
    view.show();
  });
  link.on("route", (found) => {
    world.route = readPlan(found);
    if (!world.preview) {
      world.shown = world.route;
      free.plan(world.route, "driven");
    }
    view.show();
  });
  return { choose, lock, showRobot };
}

// The worst transition is the one with the highest body risk B.
export function readPlan(found) {
  const body = found.transition_body;
  return { ...found, worst: body.length ? body.indexOf(Math.max(...body)) : -1 };
}

// At most so much of the way [m] leads over ground that nobody saw or that is assumed.
const unseen = (plan) =>
  plan.transition_length.reduce((sum, length, k) => sum + length * plan.transition_unknown[k], 0);
export const seenWords = (plan) =>
  unseen(plan) < 0.05 ? "all of it was seen" : `up to ${figure(unseen(plan), 1)} m of it nobody saw`;

function lines_of(plan) {
  const k = plan.worst;
  const way = `${figure(plan.length, 1)} m, about ${figure(plan.duration, 0)} s, cost ${figure(plan.cost, 1)} m, ${seenWords(plan)}.`;
  if (k < 0) return [way, plan.chance].filter(Boolean);
  const body = plan.transition_body[k];
  return [
    way,
    plan.chance ?? "",
    `Worst place: x ${figure(plan.worst_x[k])} y ${figure(plan.worst_y[k])} m, body risk ${figure(body)} (${grade(body)}), ${Math.round(100 * plan.transition_unknown[k])} % unseen.`,
  ].filter(Boolean);
}
export const grade = (risk) => (risk < 0.3 ? "easy" : risk < 0.7 ? "rough" : "hard");

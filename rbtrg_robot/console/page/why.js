// Why this way: every transition of the plan, what the native cost would have done, and what the gate says.
import { $, button, degrees, figure, list, put, table } from "./tell.js";
import { grade, seenWords } from "./drive.js";

// Where no envelope is known, neither is this.
const fails = (plan, k) => (plan.transition_p_fail[k] === null ? "?" : figure(100 * plan.transition_p_fail[k], 1));

export function makeWhy(link, view) {
  const { world } = view;
  let plan = null,
    rows = [];

  function show(found, kind) {
    plan = found;
    rows = [];
    $("step").replaceChildren();
    if (!plan?.ok) {
      put("why-sum", plan ? plan.words : "No plan yet: ask for one in Drive, or send a goal.");
      $("steps").tBodies[0]?.replaceChildren();
      return;
    }
    const native = plan.native_x.length
      ? ` The native cost alone would have gone ${figure(plan.native_length, 1)} m with a body risk of up to ${figure(plan.native_body)} (dashed).`
      : "";
    put(
      "why-sum",
      `${kind === "preview" ? "The plan that was asked for" : "The plan that is driven"}: ${figure(plan.length, 1)} m at a cost of ${figure(plan.cost, 1)} m, body risk up to ${figure(Math.max(0, ...plan.transition_body))}, ${seenWords(plan)}.${plan.chance ? ` ${plan.chance}.` : ""}${native}`,
    );
    const titles = ["#", "length m", "native", "body", "unseen %", "turn °", "cost m", "fails %"];
    rows = table(
      $("steps"),
      titles,
      plan.transition_length.map((length, k) => [
        button(String(k + 1), () => choose(k)),
        figure(length),
        figure(plan.transition_risk[k]),
        figure(plan.transition_body[k]),
        figure(100 * plan.transition_unknown[k], 0),
        figure(degrees(plan.transition_turn[k]), 0),
        figure(plan.transition_cost[k]),
        fails(plan, k),
      ]),
    );
    rows.forEach((row, k) => {
      row.classList.toggle("worst", k === plan.worst);
      row.firstChild.firstChild.setAttribute(
        "aria-label",
        `Transition ${k + 1}, body risk ${figure(plan.transition_body[k])}`,
      );
      row.onclick = () => choose(k);
    });
  }

  function choose(k) {
    world.chosen = k;
    world.shown = plan;
    view.show();
    rows.forEach((row, at) => row.classList.toggle("chosen", at === k));
    const box = document.createElement("dl");
    list(box, [
      [
        "Transition",
        `${k + 1} of ${plan.transition_length.length}, ${figure(plan.transition_length[k])} m, cost ${figure(plan.transition_cost[k])} m`,
      ],
      ["Fails", `${fails(plan, k)} %`],
      ["Native risk", figure(plan.transition_risk[k])],
      ["Body risk B", `${figure(plan.transition_body[k])} (${grade(plan.transition_body[k])})`],
      ["Front to back", `${figure(100 * plan.d_fb[k], 0)} cm (d_fb, scale 30 cm)`],
      ["Left to right", `${figure(plan.a_lr[k], 0)}° (a_lr, scale 30°)`],
      ["Under the belly", `${figure(100 * plan.p_int[k], 0)} cm (p_int, scale 30 cm)`],
      ["Unseen", `${figure(100 * plan.transition_unknown[k], 0)} %`],
      ["Turn before it", `${figure(degrees(plan.transition_turn[k]), 0)}°`],
      [
        "Worst pose",
        `x ${figure(plan.worst_x[k])} y ${figure(plan.worst_y[k])} m, heading ${figure(degrees(plan.worst_yaw[k]), 0)}°`,
      ],
    ]);
    $("step").replaceChildren(box);
  }

  // The nearest transition to a place on the ground; null beyond half a metre.
  function near(x, y) {
    const shown = world.shown;
    if (!shown?.ok || shown !== plan) return null;
    let best = null,
      least = 0.5;
    for (let k = 0; k + 1 < plan.node_x.length; k++) {
      const [ax, ay, bx, by] = [plan.node_x[k], plan.node_y[k], plan.node_x[k + 1], plan.node_y[k + 1]],
        n = (bx - ax) ** 2 + (by - ay) ** 2 || 1;
      const t = Math.max(0, Math.min(1, ((x - ax) * (bx - ax) + (y - ay) * (by - ay)) / n)),
        d = Math.hypot(ax + t * (bx - ax) - x, ay + t * (by - ay) - y);
      if (d < least) [least, best] = [d, Math.min(k, plan.transition_length.length - 1)];
    }
    return best;
  }

  function gate() {
    const { robot, limits, tracker, route_status: route } = link.newest;
    if (!robot) return;
    put("gate", robot.hindrance || robot.held || "Nothing is refused now.");
    const rows = [["Lets through", `${figure(robot.vx)} m/s, ${figure(robot.wz)} rad/s`]];
    if (limits)
      rows.push([
        "Guard allows",
        `forward ${figure(limits.forward)}, back ${figure(limits.backward)} m/s; left ${figure(limits.left)}, right ${figure(limits.right)} rad/s`,
      ]);
    if (limits?.slowed) rows.push(["In the way", limits.slowed, "word-warn"]);
    if (tracker?.hold) rows.push(["Tracker", tracker.hold, "word-warn"]);
    if (tracker?.slow) rows.push(["Slower for", tracker.slow]);
    if (route)
      rows.push(
        ["Route", route.valid ? "still good" : `no longer good: ${route.detail}`],
        ["Graph", `${route.nodes} nodes, ${route.edges} edges`],
      );
    for (const [reason, count] of Object.entries(robot.refused))
      if (count) rows.push([`Refused, ${reason}`, `${count} times since the start`]);
    list($("gate-list"), rows);
  }
  link.on("robot", () => {
    if (!$("why").hidden) gate();
  });
  return { show, choose, near, gate };
}

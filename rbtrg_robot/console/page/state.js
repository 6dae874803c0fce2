// One line on top: what is, why, and what to do about it here. The frame of the page takes its colour.
import { $, button, figure, put } from "./tell.js";

export const ACTIVE = ["accepted", "planning", "moving", "recovering", "paused"];
const LYING = ["sitting", "damped"];
const LOCATED = ["", "located", "assumed", "told", "closing"];
const SILENT = {
  console:
    "This page does not reach the console: the robot may go on by itself. STOP is tried all the same; where it is not confirmed, use the hardware stop.",
  robot: "The console is there and hears nothing of the robot. Goals and driving are locked, STOP is not.",
  link: "What you see is older than it may be. Goals and driving are locked, STOP is not.",
  odometry: "The robot does not tell where it is. Goals and driving are locked, STOP is not.",
};
const NAMES = { console: "Link lost", robot: "The robot is silent", odometry: "No place", link: "The link is slow" };

// What is true now: { tone, what, why, acts }, the most urgent first. Tones: lost, stop, warn, go, calm. Acts are names of `ACTS`.
export function stateOf(link) {
  const { robot, goal, mission, map, odometry } = link.newest;
  const line = (tone, what, why = "", ...acts) => ({ tone, what, why, acts: link.replay ? [] : acts });
  if (link.ended)
    return line("lost", "This page is let in no more", `${link.ended} STOP works from here all the same.`);
  if (!link.met) return line("lost", "Connecting");
  if (link.silent) {
    const since = link.since === Infinity ? "" : ` for ${figure(link.since, 0)} s`;
    return line("lost", NAMES[link.silent] + since, SILENT[link.silent]);
  }
  if (!robot) return line("lost", "Nothing is known of the robot yet");
  if (robot.estop) return line("stop", "Stopped", robot.estop_cause, "resume");
  if (robot.phase === "fault") return line("stop", "Robot fault", robot.cause, "recover");
  if (robot.phase === "disconnected") return line("warn", "The robot is out of contact", robot.cause);
  if (LYING.includes(robot.phase))
    return line("warn", `The robot is ${robot.phase}`, "It drives nowhere before it stands.", "stand");
  if (robot.taken)
    return line(
      "warn",
      "Driven by hand",
      goal?.state === "paused" ? "The goal waits." : "The stack waits for the motion.",
      "resume",
    );
  if (mission?.question) return line("warn", "The mission asks", mission.question, "answer");
  if (odometry?.health === "lost") return line("warn", "The place is lost", odometry.reason);
  if (!LOCATED.includes(map?.location ?? ""))
    return line("warn", "The robot looks for its place", map.location_detail, "place");
  if (goal && ACTIVE.includes(goal.state)) {
    const left = goal.left
      ? `, ${figure(goal.left, 1)} m ${goal.frontier ? "to the edge of what is seen" : "left"}`
      : "";
    const why = [robot.held, goal.chance, goal.words].filter(Boolean).join("; ");
    return line(robot.held ? "warn" : "go", `Goal ${goal.state}${left}`, why, "cancel");
  }
  if (mission?.phase === "paused") return line("warn", "Mission paused", mission.reason, "goon");
  if (mission?.phase === "holding") return line("warn", "Mission holding", mission.reason, "missions");
  if (mission?.phase === "running") return line("go", "Mission running", mission.words, "missions");
  const held = robot.held || robot.hindrance;
  if (goal?.state === "aborted" || goal?.state === "rejected") {
    const stopped = goal.reason === "emergency_stop";
    const at = `to x ${figure(goal.x, 1)} y ${figure(goal.y, 1)} m`;
    const why = stopped ? `The goal ${at} was stopped.` : `The goal ${at} was ${goal.state}: ${goal.words}.`;
    return line("calm", `Robot ${robot.phase}`, [why, held].filter(Boolean).join(" "), stopped ? "continue" : "again");
  }
  return line(
    "calm",
    `Robot ${robot.phase}`,
    [goal?.state === "reached" ? "Goal reached" : "", held].filter(Boolean).join(" · "),
  );
}

export function makeState(link, free) {
  const posture = (what) => () => free.tell({ do: "posture", what });
  const once = () => {
    const { x, y, yaw } = link.newest.goal;
    return free.tell({ do: "goal", x, y, yaw });
  };
  const resumes = () =>
    link.newest.robot.estop
      ? "Release the stop"
      : link.newest.goal?.state === "paused"
        ? "Continue the goal"
        : "Give the motion back";
  // Name: words, what a press does, and whether it commands: then it is locked as goals are.
  const ACTS = {
    resume: [resumes, () => free.tell({ do: "resume" }), true],
    cancel: ["Cancel the goal", () => free.tell({ do: "cancel" }), true],
    continue: ["Continue", once, true],
    again: ["Try again", once, true],
    stand: ["Stand up", posture("stand"), true],
    recover: ["Recover", posture("recover"), true],
    goon: [
      "Continue the mission",
      () => free.tell({ do: "mission", what: "resume", order_id: link.newest.mission.order_id }),
      true,
    ],
    answer: [
      "Answer",
      () => {
        free.open("missions");
        $("question").scrollIntoView({ block: "nearest" });
      },
    ],
    missions: ["Mission", () => free.open("missions")],
    place: ["Show its place", () => free.open("maps")],
  };
  let shown = "",
    tone = "";

  function show() {
    const { tone: now, what, why, acts } = stateOf(link);
    put("said", what);
    put("why-still", why);
    $("why-still").title = why;
    put("phase", link.silent || !link.newest.robot ? "" : link.newest.robot.phase);
    if (now !== tone) document.body.dataset.state = tone = now;
    const words = acts.map((name) => (typeof ACTS[name][0] === "string" ? ACTS[name][0] : ACTS[name][0]()));
    if (shown !== words.join()) {
      shown = words.join();
      $("state-acts").replaceChildren(
        ...acts.map((name, k) => {
          const made = button(words[k], ACTS[name][1]);
          made.id = `act-${name}`;
          made.className = name === "cancel" ? "" : "main";
          return made;
        }),
      );
    }
    acts.forEach((name, k) => ($("state-acts").children[k].disabled = !!ACTS[name][2] && !free.may()));
  }
  for (const kind of ["robot", "goal", "mission", "map", "odometry", "age", "replay", "open", "close", "beat"])
    link.on(kind, show);
  show();
}

// The page: one connection, one picture, six views, and STOP on all of them.
import { makeArchive } from "./archive.js";
import { makeDrive } from "./drive.js";
import { makeHealth } from "./health.js";
import { open } from "./link.js";
import { makeMaps } from "./maps.js";
import { makeMissions } from "./missions.js";
import { makeStick } from "./stick.js";
import { $, figure, put, twice } from "./tell.js";
import { makeWhy } from "./why.js";
import { mount } from "./view/mount.js";

const link = open();
stopping();
const about = await (await fetch("/about")).json();
const small = matchMedia("(max-width: 860px)").matches;
let why,
  drive,
  stick,
  missions,
  maps,
  spoken = "",
  was = "",
  timer = 0;

const free = {
  operating: () => !link.replay && link.role === "operator" && link.newest.beat?.operator === link.page,
  say(words, kind = "") {
    banner(words, kind);
    clearTimeout(timer);
    timer = setTimeout(() => banner(""), 8000);
  },
  plan: (plan, kind) => why.show(plan, kind),
};

const view = mount($("view"), {
  flat: new URLSearchParams(location.search).has("flat"),
  said: (words) => put("hint", words || HINT()),
  followed: (on) => $("follow").setAttribute("aria-pressed", on),
  pick(x, y, yaw) {
    if (maps.pick(x, y, yaw)) return;
    const k = yaw === null && !$("why").hidden ? why.near(x, y) : null;
    if (k !== null) return why.choose(k);
    if (link.fresh !== "stale" && free.operating()) {
      show("drive");
      drive.choose(x, y, yaw);
    } else
      free.say(
        link.replay
          ? "This is a replay: nothing here moves the robot."
          : link.fresh === "stale"
            ? "What you see is old: no goal is taken."
            : "Another page operates: take over first.",
        "bad",
      );
  },
});
view.world.body = about.body;
const HINT = () =>
  view.moving
    ? "Drag to turn the view; two fingers move and zoom."
    : "Tap the ground for a goal; press and drag for its heading. Right button or two fingers: the view.";
put("hint", HINT());
put("name", about.robot);
document.title = `${about.robot} console`;

why = makeWhy(link, view);
drive = makeDrive(link, view, about, free);
stick = makeStick(link, view, about, free);
missions = makeMissions(link, view, free);
maps = makeMaps(link, view, free);
const health = makeHealth(link, about),
  archive = makeArchive(link, free);

// --- views --------------------------------------------------------------------------------------------------
function show(name) {
  document.body.dataset.view = name;
  for (const made of document.querySelectorAll("nav button"))
    (made.toggleAttribute("aria-current", made.dataset.view === name),
      made.dataset.view === name && made.setAttribute("aria-current", "page"));
  for (const panel of document.querySelectorAll(".panel")) panel.hidden = panel.id !== name;
  ({ health: health.show, logs: archive.runs, maps: maps.show, missions: missions.show, why: why.gate })[name]?.();
}
for (const made of document.querySelectorAll("nav button")) made.onclick = () => show(made.dataset.view);
show("drive");

// --- the picture --------------------------------------------------------------------------------------------
function press(id, on, act) {
  const made = $(id);
  made.onclick = () => {
    const now = made.getAttribute("aria-pressed") !== "true";
    made.setAttribute("aria-pressed", now);
    act(now);
    view.show();
  };
  made.setAttribute("aria-pressed", on);
  act(on);
}
press("mode", false, (on) => {
  view.moving = on;
  put("hint", HINT());
});
press("follow", true, (on) => {
  view.follow = on;
});
press("points", !small, (on) => {
  view.world.points = on;
  if (link.seen) see();
});
press("graph", false, (on) => {
  view.world.showGraph = on;
  if (on) askGraph();
});
$("top").onclick = () => put("top", view.above() ? "From the side" : "From above");
const LAYERS = [
  ["low", "high", ["#66878c", "#a8ad8f", "#dbbf94"]],
  ["flat", "limit", ["#4c998c", "#e5cc66", "#9e1a38"]],
  ["unseen", "wheels", ["#8c8c8c", "#599ebf", "#40b373"]],
  ["now", "1 min", ["#4dadcc", "#9e9ea8", "#6b5c66"]],
];
function legend() {
  const [from, to, colours] = LAYERS[view.world.layer],
    bar = document.createElement("canvas"),
    paint = bar.getContext("2d");
  bar.width = 110;
  bar.height = 12;
  const shade = paint.createLinearGradient(0, 0, 110, 0);
  colours.forEach((colour, k) => shade.addColorStop(k / 2, colour));
  paint.fillStyle = shade;
  paint.fillRect(0, 0, 110, 12);
  $("legend").replaceChildren(
    view.world.layer ? from : `${figure(view.ground.low, 1)} m`,
    bar,
    view.world.layer ? to : `${figure(view.ground.high, 1)} m`,
    small ? "" : "· hatched: not trusted",
  );
}
$("layer").onchange = () => {
  view.world.layer = Number($("layer").value);
  legend();
  view.show();
};
async function askGraph() {
  const { pose } = view.world;
  if (!pose) return;
  const { found } = await link.wish({ do: "ask", x: pose.x, y: pose.y, graph: true }).catch(() => ({}));
  if (!found?.graph_x?.length) return;
  const at = new Float32Array(found.graph_from.length * 6),
    colour = new Uint8Array(found.graph_from.length * 8);
  found.graph_from.forEach((from, k) =>
    [from, found.graph_to[k]].forEach((node, end) => {
      at.set([found.graph_x[node], found.graph_y[node], found.graph_z[node] + 0.04], 6 * k + 3 * end);
      colour.set([20 + 200 * Math.min(1, found.graph_risk[k]), 90, 150, 150], 8 * k + 4 * end);
    }),
  );
  view.world.graph = { at, colour };
  view.show();
}
const dark = matchMedia("(prefers-color-scheme: dark)");
const sky = () => {
  view.world.sky = dark.matches ? [0.114, 0.149, 0.176] : [0.875, 0.902, 0.918];
  view.show();
};
dark.onchange = sky;
sky();

// --- what comes ---------------------------------------------------------------------------------------------
link.on("pose", (pose) => {
  const before = view.world.pose;
  view.world.pose = pose;
  // A robot that stands is not drawn ten times a second.
  if (
    !before ||
    [..."xyz"].some((axis) => Math.abs(pose[axis] - before[axis]) > 0.002) ||
    pose.q.some((v, k) => Math.abs(v - before.q[k]) > 0.002)
  )
    view.show();
  else view.world.pose = before;
});
link.on("terrain", (data) => {
  view.ground.take(data);
  legend();
  view.show();
});
link.on("points", (data) => {
  const head = new Float32Array(data, 4, 7);
  view.world.cloud = { place: head.slice(0, 3), turn: head.slice(3, 7), points: new Int16Array(data, 32) };
  view.show();
});
function see() {
  link.quick({ do: "see", cloud: view.world.points });
}
// A replay is another picture: what was drawn goes. Whoever looks at one commands nothing but the stop.
function replayed({ run, state, seconds, wrong }) {
  if (link.replay !== run) {
    link.replay = run;
    for (const kind of [
      "pose",
      "robot",
      "goal",
      "mission",
      "mission_order",
      "odometry",
      "map",
      "limits",
      "route_status",
      "tracker",
    ])
      delete link.newest[kind];
    Object.assign(view.world, {
      pose: null,
      route: null,
      preview: null,
      goal: null,
      cloud: null,
      graph: null,
      shown: null,
      mission: null,
      place: null,
      arc: null,
    });
    view.ground.tiles.clear();
    view.ground.dirty.add("all");
    why.show(null);
    drive.lock();
    missions.lock();
    maps.lock();
    stick.drop();
    document.body.toggleAttribute("data-replay", !!run);
    $("replaybar").hidden = !run;
    view.show();
  }
  put(
    "replay-said",
    wrong
      ? `${run}: ${wrong}`
      : `${run}, ${state === "ended" ? "at its end" : `${figure(seconds ?? 0, 0)} s`}. Nothing here moves the robot; STOP stops the real one.`,
  );
  lease();
}
link.on("replay", replayed);
link.on("welcome", () => {
  if (link.replay) replayed({ run: "" });
}); // a connection begins with the robot
link.on("open", () => {
  view.ground.tiles.clear();
  view.ground.dirty.add("all");
  see();
});
link.on("age", (changed) => {
  document.body.dataset.fresh = link.fresh;
  view.world.fresh = link.fresh;
  const seconds = link.age === Infinity ? "no data" : `${figure(Math.min(link.age, 999), 1)} s old`;
  put("fresh", link.fresh === "live" ? "live" : link.fresh === "old" ? seconds : `stale: ${seconds}`);
  lease();
  if (!changed) return;
  if (link.fresh === "stale")
    speak(
      `What you see is old: ${{ console: "the console is silent", robot: "the robot is silent", odometry: "the odometry is silent" }[link.silent] ?? "no data"}. Goals and driving are locked, STOP is not.`,
    );
  if (link.fresh === "live") speak("");
  drive.lock();
  missions.lock();
  maps.lock();
  stick.show();
  view.show();
});
link.on("robot", (robot) => {
  const words = link.replay
    ? ""
    : robot.estop
      ? `Emergency stop: ${robot.estop_cause}`
      : ["fault", "disconnected"].includes(robot.phase)
        ? `${robot.phase}: ${robot.cause}`
        : "";
  if (words !== spoken) {
    spoken = words;
    put("live", words);
  }
  lease();
});
link.on("beat", () => lease());
link.seen = true;
see(); // everything that hears is there now
function lease() {
  const { beat } = link.newest,
    operating = free.operating();
  const words = !link.connected()
    ? "not connected"
    : link.replay
      ? "replay"
      : link.role === "observer"
        ? "observer: look and stop"
        : operating
          ? "you operate"
          : beat?.operator
            ? `page ${beat.operator} operates`
            : "nobody operates";
  put("lease", words);
  $("take").hidden = operating || !!link.replay || link.role !== "operator" || !beat?.operator || !link.connected();
  if (words !== was) {
    was = words;
    drive.lock();
    missions.lock();
    maps.lock();
    stick.show();
  }
}
twice(
  $("take"),
  () => `Page ${link.newest.beat.operator} can then only look and stop. Really take over?`,
  async () => {
    const answer = await link.wish({ do: "take over" }).catch((error) => ({ words: error.message, ok: false }));
    free.say(answer.words, answer.ok ? "" : "bad");
  },
);

function banner(words, kind = "") {
  const at = $("banner");
  at.hidden = !words;
  at.className = kind;
  at.textContent = words;
}
const speak = (words) => banner(words, words ? "bad" : "");

// --- STOP: before everything else on this page, and without it -----------------------------------------------
function stopping() {
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
  link.on("halt", ({ state, words }) => {
    const at = $("stop-said");
    at.className = state === "confirmed" ? "good" : state === "unconfirmed" ? "bad" : "";
    if (at.textContent !== words) at.textContent = words;
  });
}
window.consoleView = view; // for tests, and for the curious

// The page: one connection, one picture, seven views, and STOP on all of them.
import { makeArchive } from "./archive.js";
import { makeDraw } from "./draw.js";
import { makeDrive } from "./drive.js";
import { makeEvents } from "./events.js";
import { makeHalt } from "./halt.js";
import { makeHealth } from "./health.js";
import { makeLead } from "./lead.js";
import { open } from "./link.js";
import { makeMaps } from "./maps.js";
import { makeMeasure } from "./measure.js";
import { makeMissions } from "./missions.js";
import { makePicture } from "./picture.js";
import { makeState } from "./state.js";
import { makeStick } from "./stick.js";
import { $, figure, put, twice } from "./tell.js";
import { makeWhy } from "./why.js";
import { mount } from "./view/mount.js";

const link = open();
makeHalt(link);
const about = await (await fetch("/about")).json();
let why,
  draw,
  drive,
  stick,
  missions,
  maps,
  picture,
  lead,
  spoken = "",
  was = "",
  timer = 0;

const free = {
  may: () => link.fresh !== "stale" && free.operating(),
  open: (name) => show(name),
  async tell(content) {
    const answer = await link.wish(content).catch((error) => ({ ok: false, words: error.message }));
    if (!answer.ok) free.say(answer.words, "bad"); // what was done is told by the line of state
    return answer;
  },
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
  said: (words) => (picture ? picture.hint(words) : put("hint", words)),
  followed: (on) => $("follow").setAttribute("aria-pressed", on),
  grab: (x, y) => missions?.grab(x, y),
  pick(x, y, yaw) {
    if (lead) return lead.pick(x, y);
    if (maps.pick(x, y, yaw) || draw.pick(x, y, yaw)) return;
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
put("name", about.robot);
document.title = `${about.robot} console`;

makeMeasure(view);
picture = makePicture(link, view, about, free);
if (!$("hint").textContent) picture.hint();
why = makeWhy(link, view);
drive = makeDrive(link, view, about, free);
draw = makeDraw(link, view, about, free);
stick = makeStick(link, view, about, free);
missions = makeMissions(link, view, free);
maps = makeMaps(link, view, free);
const health = makeHealth(link, about),
  archive = makeArchive(link, free),
  events = makeEvents(link, view, about, free, archive);
lead = about.step && makeLead(link, view, about, free);

// --- views --------------------------------------------------------------------------------------------------
function show(name) {
  document.body.dataset.view = name;
  for (const made of document.querySelectorAll("nav button"))
    (made.toggleAttribute("aria-current", made.dataset.view === name),
      made.dataset.view === name && made.setAttribute("aria-current", "page"));
  for (const panel of document.querySelectorAll(".panel")) panel.hidden = panel.id !== name;
  $("help").href = `/docs/${$(name).dataset.help}`;
  ({
    events: events.show,
    health: health.show,
    logs: archive.runs,
    maps: maps.show,
    missions: missions.show,
    why: why.gate,
  })[name]?.();
}
for (const made of document.querySelectorAll("nav button")) made.onclick = () => show(made.dataset.view);
show(lead ? "lead" : "drive");

// A replay is another picture: what was drawn goes. Whoever looks at one commands nothing but the stop.
function replayed({ run, state, seconds, paused, wrong }) {
  if (link.replay !== run) {
    link.replay = run;
    for (const kind of [
      "pose",
      "robot",
      "goal",
      "mission",
      "mission_order",
      "areas",
      "odometry",
      "map",
      "limits",
      "route_status",
      "tracker",
      "events",
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
      candidates: null,
      arc: null,
      mark: null,
      drawn: null,
    });
    picture.clear();
    why.show(null);
    drive.lock();
    missions.lock();
    maps.lock();
    stick.drop();
    document.body.toggleAttribute("data-replay", !!run);
    $("replaybar").hidden = !run;
    picture.hint();
    view.show();
  }
  put(
    "replay-said",
    wrong
      ? `${run}: ${wrong}`
      : `${run}, ${state === "ended" ? "at its end" : `${paused ? "paused at " : ""}${figure(seconds ?? 0, 0)} s`}. ${lead ? "There is no robot here." : "Nothing here moves the robot; STOP stops the real one."}`,
  );
  put("replay-pause", paused ? "Go on" : "Pause");
  $("replay-pause").hidden = !run || state === "ended" || link.role !== "operator";
  lease();
}
link.on("replay", replayed);
link.on("welcome", () => {
  if (link.replay) replayed({ run: "" });
}); // a connection begins with the robot
link.on("age", (changed) => {
  document.body.dataset.fresh = link.fresh;
  view.world.fresh = link.fresh;
  const seconds = link.age === Infinity ? "no data" : `${figure(Math.min(link.age, 999), 1)} s old`;
  put("fresh", link.fresh === "live" ? "live" : link.fresh === "old" ? seconds : `stale: ${seconds}`);
  lease();
  if (!changed) return;
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
// The answer to a goal floats above STOP on a phone: what lies below it can be scrolled out as well.
new ResizeObserver(([dock]) => {
  const floats = getComputedStyle(dock.target).position === "fixed";
  document.body.style.setProperty("--dock", `${floats ? dock.borderBoxSize[0].blockSize : 0}px`);
}).observe($("verdict"));
// What stands at the end of the page can be scrolled out from behind the bar, however high its warnings make it.
new ResizeObserver(([bar]) => document.body.style.setProperty("--bar", `${bar.borderBoxSize[0].blockSize}px`)).observe(
  $("stopbar"),
);

makeState(link, free);
picture.begin();
window.consoleView = view; // for tests, and for the curious

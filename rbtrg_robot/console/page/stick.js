// Driving by hand: twenty velocities a second while something is held, and none after. The robot itself lets go after 0.2 s of silence.
import { grade } from "./drive.js";
import { $, figure, put } from "./tell.js";

const PERIOD = 50,
  AHEAD = 2.0,
  PIECES = 8; // milliseconds, seconds, of the arc
const ENABLE = 4,
  TURBO = 5; // shoulder buttons of a standard gamepad

export function makeStick(link, view, about, free) {
  const stick = $("stick"),
    knob = $("knob"),
    keys = new Set();
  let held = null,
    x = 0,
    y = 0,
    pad = null,
    driving = false;

  const may = () => link.fresh !== "stale" && free.operating() && !document.hidden;
  function hold(by) {
    if (may()) held = by;
  }
  function drop() {
    held = null;
    x = y = 0;
    keys.clear();
    show();
    if (driving) {
      driving = false;
      send(0, 0);
      send(0, 0);
    }
  }
  function show() {
    stick.classList.toggle("held", held !== null);
    stick.classList.toggle("off", !may());
    knob.style.transform = `translate(${50 * x}px, ${-50 * y}px)`;
  }
  function set(dx, dy) {
    const n = Math.max(1, Math.hypot(dx, dy));
    x = dx / n;
    y = dy / n;
  }

  function pull(event) {
    const box = stick.getBoundingClientRect();
    set((event.clientX - box.left - box.width / 2) / 52, -(event.clientY - box.top - box.height / 2) / 52);
  }
  stick.addEventListener("pointerdown", (event) => {
    event.preventDefault();
    stick.setPointerCapture(event.pointerId);
    hold("stick");
    if (held === "stick") pull(event);
    show();
  });
  stick.addEventListener("pointermove", (event) => {
    if (held === "stick") {
      pull(event);
      show();
    }
  });
  for (const end of ["pointerup", "pointercancel", "lostpointercapture"])
    stick.addEventListener(end, () => {
      if (held === "stick") drop();
    });
  const KEY = {
    ArrowUp: [0, 1],
    KeyW: [0, 1],
    ArrowDown: [0, -1],
    KeyS: [0, -1],
    ArrowLeft: [-1, 0],
    KeyA: [-1, 0],
    ArrowRight: [1, 0],
    KeyD: [1, 0],
  };
  function byKeys() {
    let dx = 0,
      dy = 0;
    for (const code of keys) {
      dx += KEY[code][0];
      dy += KEY[code][1];
    }
    set(dx, dy);
    show();
  }
  stick.addEventListener("keydown", (event) => {
    if (KEY[event.code]) {
      event.preventDefault();
      keys.add(event.code);
      hold("keys");
      if (held) byKeys();
    }
  });
  stick.addEventListener("keyup", (event) => {
    if (keys.delete(event.code)) {
      if (keys.size) byKeys();
      else drop();
    }
  });
  stick.addEventListener("blur", () => {
    if (held === "keys") drop();
  });
  window.addEventListener("blur", drop);
  window.addEventListener("pagehide", drop);
  document.addEventListener("visibilitychange", () => {
    if (document.hidden) drop();
  });
  window.addEventListener("gamepaddisconnected", () => {
    if (held === "pad") drop();
  });
  link.on("close", drop);

  function gamepad() {
    pad = [...(navigator.getGamepads?.() ?? [])].find((found) => found?.connected) ?? null;
    put(
      "pad",
      pad
        ? `Gamepad: hold ${pad.mapping === "standard" ? "the left shoulder button" : "button 5"} and use the left stick; the right shoulder button is full speed.`
        : "No gamepad",
    );
    if (!pad?.buttons[ENABLE]?.pressed) {
      if (held === "pad") drop();
      return;
    }
    if (held === null) hold("pad");
    if (held === "pad") {
      const [a, b] = pad.axes.map((v) => (Math.abs(v) < 0.12 ? 0 : v));
      set(a, -b);
      show();
    }
  }
  const speed = () => (held === "pad" && pad?.buttons[TURBO]?.pressed ? 1 : Number($("speed").value));

  function send(v, w) {
    link.quick({ do: "drive", v, w, seen: link.seen });
  }
  setInterval(() => {
    gamepad();
    if (held && !may()) drop();
    if (!held) return;
    const v = y * speed() * about.max_vx,
      w = -x * speed() * about.max_wz;
    driving = true;
    send(v, w);
    view.world.arc = arc(v, w);
    view.show();
  }, PERIOD);
  // What came of it, in words.
  link.on("robot", (robot) => {
    if (!held && view.world.arc) {
      view.world.arc = null;
      view.show();
    }
    put(
      "hand-said",
      !free.operating()
        ? "Another page operates"
        : link.fresh === "stale"
          ? "Locked: what you see is old"
          : robot.estop
            ? "The robot is stopped"
            : held
              ? `${figure(robot.vx)} m/s, ${figure(robot.wz)} rad/s${link.lag()}${ahead()}`
              : robot.taken
                ? "You have the motion"
                : `Hold the stick${link.lag()}`,
    );
    const limits = link.newest.limits;
    put("hand-why", held ? robot.held || limits?.slowed || "" : "");
  });

  // The colour of the arc, in words.
  function ahead() {
    const risks = (view.world.arc ?? []).map(({ risk }) => risk);
    if (!risks.length) return "";
    if (risks.some(Number.isNaN)) return ", unseen ground ahead";
    const worst = Math.max(...risks);
    return `, ${grade(worst)} ground ahead (${figure(worst)})`;
  }

  // Poses of the body on the arc that is asked for, with the risk the body would meet there.
  function arc(v, w) {
    const { pose } = view.world,
      poses = [];
    if (!pose || (Math.abs(v) < 0.02 && Math.abs(w) < 0.02)) return null;
    for (let k = 0; k <= PIECES; k++) {
      const t = (AHEAD * k) / PIECES,
        turn = w * t,
        ahead = Math.abs(w) < 1e-3 ? v * t : (v / w) * Math.sin(turn),
        aside = Math.abs(w) < 1e-3 ? 0 : (v / w) * (1 - Math.cos(turn));
      const px = pose.x + Math.cos(pose.yaw) * ahead - Math.sin(pose.yaw) * aside,
        py = pose.y + Math.sin(pose.yaw) * ahead + Math.cos(pose.yaw) * aside,
        yaw = pose.yaw + turn;
      poses.push({ x: px, y: py, yaw, risk: view.ground.body(px, py, yaw, ...about.body) });
    }
    return poses;
  }
  return { show, drop };
}

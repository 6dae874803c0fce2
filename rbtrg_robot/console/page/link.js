// The connection: frames in, wishes out, how old everything is, and the stop.
// Frames are only stored here; what is drawn reads them later. STOP never waits behind a picture.

const OLD = 0.5,
  STALE = 0.9; // seconds
const STOP_AGAIN = 250,
  STOP_WORRY = 1000,
  STOP_PATIENCE = 30000; // milliseconds
const ENDED = 4401; // code with which the console closes a page that it lets in no more
const STEADY = ["/odom", "/robot/state"];
const text = new TextDecoder();

export function open() {
  const hears = new Map();
  const waiting = new Map();
  const link = {
    newest: {},
    page: 0,
    role: "",
    replay: "",
    fresh: "stale",
    age: Infinity,
    met: false, // there was a connection
    silent: "console", // whose words are missing, or the link that is slow, and since how many seconds
    since: Infinity,
    ended: "", // what to do where the console lets this page in no more
    seen: "", // newest stamp of the robot that this page saw: every velocity echoes it, and the robot refuses what is older than 0.5 s
    delay: 0, // seconds that this page's picture is behind the robot, there and back again on its link
    lag: () => (link.delay ? `, link ${Math.round(1000 * link.delay)} ms` : ""),
    on,
    wish,
    quick,
    halt,
    connected: () => socket?.readyState === 1,
  };
  let socket,
    beat = -Infinity,
    ages = {},
    number = 0,
    pressed = 0,
    mine = 0, // the number that the console gave this page's newest STOP; 0: it has not taken it
    confirmed = true;

  function on(kind, hear) {
    hears.set(kind, [...(hears.get(kind) ?? []), hear]);
  }
  function tell(kind, content) {
    for (const hear of hears.get(kind) ?? []) hear(content);
  }

  function dial() {
    socket = new WebSocket(`${location.protocol === "https:" ? "wss" : "ws"}://${location.host}/live`);
    socket.binaryType = "arraybuffer";
    socket.onmessage = ({ data }) => take(data);
    socket.onopen = () => {
      mine = 0; // the server that took a stop may be gone
      delete link.newest.stop;
      link.ended = "";
      beat = performance.now();
      tell("open");
      look();
    };
    socket.onclose = ({ code, reason }) => {
      if (code === ENDED) link.ended = reason;
      for (const { no } of waiting.values()) no(new Error(link.ended || "the console is gone"));
      waiting.clear();
      look();
      tell("close");
      setTimeout(dial, 500);
    };
  }

  function take(data) {
    const kind = new Uint8Array(data, 0, 1)[0];
    if (kind === 2) return tell("terrain", data);
    if (kind === 3) return tell("points", data);
    if (kind === 4) return tell("ages", data);
    if (kind === 5) return tell("picture", data);
    const content = JSON.parse(text.decode(new Uint8Array(data, 4)));
    link.newest[content.kind] = content;
    if (content.kind === "beat") {
      beat = performance.now();
      ages = content.ages;
      link.met = true;
      look();
    }
    if (content.kind === "robot") link.seen = content.seen;
    if (content.kind === "robot" && content.hands >= 0) link.delay = content.hands;
    if (content.kind === "link") {
      link.delay = content.delay;
      look();
    }
    if (content.kind === "welcome") {
      link.page = content.page;
      link.role = content.role;
    }
    if (content.kind === "stop") stopSaid(content);
    if (content.kind === "answer") {
      const { yes } = waiting.get(content.n) ?? {};
      waiting.delete(content.n);
      yes?.(content);
    }
    tell(content.kind, content);
  }

  // By a timer, not by the frames of a picture: a page that draws slowly must still say that it is old.
  function look() {
    const since = (performance.now() - beat) / 1000;
    const topics = STEADY.map((name) => (name in ages ? ages[name] + since : Infinity));
    const lost = socket?.readyState !== 1;
    link.age = Math.max(since, link.delay, ...topics);
    link.silent =
      lost || since > STALE
        ? "console"
        : topics[1] > STALE
          ? "robot"
          : topics[0] > STALE
            ? "odometry"
            : link.delay > STALE
              ? "link"
              : "";
    link.since = { console: since, robot: topics[1], odometry: topics[0], link: link.delay }[link.silent] ?? 0;
    const fresh = lost || link.age > STALE ? "stale" : link.age > OLD ? "old" : "live";
    const changed = fresh !== link.fresh;
    link.fresh = fresh;
    tell("age", changed);
  }

  function quick(content) {
    if (socket?.readyState === 1) socket.send(JSON.stringify(content));
  }
  function wish(content) {
    return new Promise((yes, no) => {
      if (socket?.readyState !== 1) return no(new Error("the console is not connected"));
      waiting.set(++number, { yes, no });
      socket.send(JSON.stringify({ ...content, n: number }));
    });
  }

  // --- the stop -------------------------------------------------------------------------------------------
  function stopSaid({ state, words, press }) {
    if (pressed && !(mine && press >= mine)) return; // of a stop of before: no answer to this one
    confirmed = state === "confirmed";
    if (confirmed) pressed = 0;
    tell("halt", { state, words });
  }

  function halt() {
    pressed = performance.now();
    confirmed = false;
    mine = 0;
    delete link.newest.stop; // of a stop of before, perhaps of a server that is gone: a new one counts from 1
    tell("halt", { state: "sending", words: "STOP sent, waiting for the robot" });
    send();
    const again = setInterval(() => {
      const waited = performance.now() - pressed;
      if (confirmed || !pressed || waited > STOP_PATIENCE) return clearInterval(again);
      if (!mine) send();
      if (waited > STOP_WORRY)
        tell("halt", {
          state: "unconfirmed",
          words: mine
            ? "STOP NOT CONFIRMED: use the hardware stop"
            : "STOP NOT CONFIRMED, the console does not answer: use the hardware stop",
        });
    }, STOP_AGAIN);
  }
  function send() {
    quick({ do: "stop" });
    const press = pressed;
    fetch("/stop", { method: "POST", keepalive: true, priority: "high" })
      .then((answer) => (answer.ok ? answer.json() : Promise.reject()))
      .then((taken) => {
        if (press !== pressed || mine) return;
        mine = taken.press;
        stopSaid(link.newest.stop ?? taken); // its frame may have come before this answer
      })
      .catch(() => {});
  }

  setInterval(look, 100);
  setInterval(
    () => quick({ do: "alive", seen: link.seen, watched: !document.hidden && !link.replay && link.fresh !== "stale" }),
    500,
  );
  dial();
  return link;
}

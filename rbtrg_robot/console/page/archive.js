// Runs on the robot's disk.
import { $, anchor, button, figure, get, list, post, put, table } from "./tell.js";

export function makeArchive(link, free) {
  let shown = "",
    job = "";
  const say = (error) => free.say(error.message, "bad");

  async function runs() {
    const found = await get("/runs");
    table(
      $("runs"),
      ["run", "MB", ["", "text"]],
      found.map((run) => {
        const act = document.createElement("span");
        act.className = "row";
        act.append(
          button("Look", () => look(run.name).catch(say)),
          ...run.files.map((file) => anchor(file, `/runs/${run.name}/${file}`)),
        );
        act.append(
          button(run.kept ? "Let go" : "Keep", () =>
            post(`/runs/${run.name}/keep`, { keep: !run.kept }).then(runs).catch(say),
          ),
        );
        const said = run.now ? "this run" : run.kept ? "kept" : "";
        return [[said ? `${run.name}, ${said}` : run.name, "wrap"], figure(run.megabytes, 1), act];
      }),
    );
  }
  async function look(name, logged = 0) {
    const { facts, topics, damage, unfinished, begin } = await get(`/runs/${name}`);
    $("replay-from").value = figure(Math.max(0, logged - begin), 0);
    const meta = Object.entries(facts).flatMap(([, group]) => (typeof group === "object" ? Object.entries(group) : []));
    $("run-card").hidden = false;
    shown = name;
    put("run-name", name);
    $("photos").open = false;
    list($("run-facts"), [
      ...meta.filter(([key]) => !key.startsWith("package")).map(([key, value]) => [key, String(value)]),
      ...unfinished.map((file) => ["being written", `${file}: what it holds is counted at its end`]),
      ...damage.map((words) => ["damage", words, "word-bad"]),
    ]);
    table(
      $("run-topics"),
      ["topic", "messages", "Hz"],
      topics.map((x) => [[x.topic, "wrap"], String(x.count), figure(x.rate, 1)]),
    );
    $("run-card").scrollIntoView();
  }
  // The newest first; each is fetched when it comes on screen.
  async function photos() {
    const name = shown;
    $("photo-list").replaceChildren();
    put("photos-said", "Reading…");
    const found = await get(`/runs/${name}/photos`);
    if (name !== shown) return;
    put("photos-said", found.length ? "" : "No photos. `Photo` under the camera's picture keeps one.");
    $("photo-list").replaceChildren(
      ...found.toReversed().map(({ name: file, stamp }) => {
        const made = document.createElement("li"),
          image = document.createElement("img"),
          at = new Date(1000 * stamp).toLocaleString([], { hour12: false });
        image.loading = "lazy";
        image.alt = `Photo of ${at}`;
        image.src = `/runs/${name}/photos/${file}`;
        made.append(image, anchor(at, image.src));
        return made;
      }),
    );
  }
  $("photos").ontoggle = () => {
    if ($("photos").open) photos().catch((error) => put("photos-said", error.message));
  };
  $("reload-runs").onclick = () => runs().catch(say);
  async function wish(content) {
    const answer = await link.wish(content).catch((error) => ({ words: error.message }));
    free.say(answer.words, answer.ok ? "" : "bad");
  }
  $("replay-form").onsubmit = (event) => {
    event.preventDefault();
    wish({ do: "replay", run: shown, rate: Number($("replay-rate").value), start: $("replay-from").value });
  };
  $("replay-end").onclick = () => wish({ do: "live" });
  $("replay-pause").onclick = () => link.quick({ do: "pause replay", on: $("replay-pause").textContent === "Pause" });
  $("again-go").onclick = () =>
    wish({ do: "rerun", run: shown, stages: $("again-stages").value, sets: $("again-sets").value });
  link.on("job", ({ run, out, state, stages, sets, seconds, words, wrong }) => {
    const what = `${run} again (${[...stages, ...sets].join(", ")})`;
    put(
      "job",
      state === "running"
        ? `${what}: ${figure(seconds, 0)} s of the log are done`
        : state === "done"
          ? `${what} is ${out}: ${words}`
          : `${what} failed: ${wrong}`,
    );
    if (job === "running" && state !== "running" && !$("logs").hidden) runs().catch(say);
    job = state;
  });
  // A run at an instant of its log's clock [s].
  function at(name, logged) {
    free.open("logs");
    return look(name, logged).catch(say);
  }
  return { runs: () => runs().catch(say), at };
}

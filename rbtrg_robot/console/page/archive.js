// Runs and maps on the robot's disk.
import { $, anchor, button, figure, get, list, post, put, table } from "./tell.js";

export function makeArchive(free) {
  const say = (error) => free.say(error.message, "bad");

  async function runs() {
    const found = await get("/runs");
    table($("runs"), ["run", "MB", ["", "text"], ["", "text"]], found.map((run) => {
      const act = document.createElement("span");
      act.className = "row";
      act.append(button("Look", () => look(run.name).catch(say)), ...run.files.map((file) => anchor(file, `/runs/${run.name}/${file}`)));
      act.append(button(run.kept ? "Let go" : "Keep", () => post(`/runs/${run.name}/keep`, { keep: !run.kept }).then(runs).catch(say)));
      return [run.name, figure(run.megabytes, 1), [run.now ? "this run" : run.kept ? "kept" : "", "text"], act];
    }));
  }
  async function look(name) {
    const { facts, topics, damage } = await get(`/runs/${name}`);
    const meta = Object.entries(facts).flatMap(([, group]) => (typeof group === "object" ? Object.entries(group) : []));
    $("run-card").hidden = false;
    put("run-name", name);
    list($("run-facts"), [...meta.filter(([key]) => !key.startsWith("package")).map(([key, value]) => [key, String(value)]), ...damage.map((words) => ["damage", words, "word-bad"])]);
    table($("run-topics"), ["topic", "messages", "Hz", "longest gap s", "MB"], topics.map((x) => [x.topic, String(x.count), figure(x.rate, 1), figure(x.gap), figure(x.megabytes)]));
    $("run-card").scrollIntoView();
  }
  async function maps() {
    const found = await get("/maps");
    table($("map-list"), ["map", "MB", ["", "text"]], found.map((map) => [map.name, figure(map.megabytes), anchor("Download", `/maps/${map.name}`)]));
  }
  $("reload-runs").onclick = () => runs().catch(say);
  $("save-map").onsubmit = async (event) => {
    event.preventDefault();
    put("map-said", "Saving…");
    try { put("map-said", (await post(`/maps/${encodeURIComponent($("map-name").value)}`)).words); await maps(); } catch (error) { put("map-said", `Not saved: ${error.message}`); }
  };
  return { runs: () => runs().catch(say), maps: () => maps().catch(say) };
}

"""`up`, `down`, `status`, `console`."""

from __future__ import annotations

import contextlib
import importlib.util
import json
import os
import signal
import subprocess
import sys
import time
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from rbtrg_robot.cli.scene_options import HeightRange, Resolution, Units, Up, chosen
from rbtrg_robot.scope import NAMED, ROBOT
from rbtrg_robot.terminal import say, say_json

if TYPE_CHECKING:
    from rbtrg_robot.config import StackConfig
    from rbtrg_robot.process.zygote import Zygote

Robot = Annotated[str, typer.Option("--robot", envvar=NAMED, help="Name of the robot.")]
DETACH_LIMIT = 1800.0
"""[s] for `--detach` to be ready: a first start compiles the kernels."""
STALL_LIMIT = 120.0
"""[s] in which every process runs and yet the stack is not ready, such as for a sensor that is silent."""
ENDS = (signal.SIGINT, signal.SIGTERM, signal.SIGHUP)
DOWN_LIMIT = 8.0
LEFT_LIMIT = 5.0
"""[s] for the others once the supervisor was killed, and once they were."""


def register(app: typer.Typer) -> None:
    """Add the commands."""
    app.command()(up)
    app.command()(down)
    app.command()(status)
    app.command()(console)


def up(
    backend: Annotated[str | None, typer.Option(help="sim, unitree or one of your own.")] = None,
    robot_model: Annotated[
        str | None, typer.Option(metavar="NAME|FOLDER", help="What the robot is: see `robot list`.")
    ] = None,
    scene: Annotated[str | None, typer.Option(help="Built-in scene or terrain file.")] = None,
    controller: Annotated[
        str | None,
        typer.Option(help="Locomotion in simulation: see `robot show`."),
    ] = None,
    policy: Annotated[
        Path | None, typer.Option(help="Locomotion policy: folder, file, or name of a fetched one.")
    ] = None,
    interface: Annotated[str | None, typer.Option(help="Network interface of the robot (unitree).")] = None,
    dry_run: Annotated[
        bool, typer.Option("--dry-run", help="Log requests to the robot, send nothing.")
    ] = False,
    map_file: Annotated[Path | None, typer.Option("--map", help="Prior map: .npz, .pcd or .ply.")] = None,
    without: Annotated[
        list[str] | None, typer.Option(metavar="PROCESS", help="Not to start; may be repeated.")
    ] = None,
    no_console: Annotated[bool, typer.Option("--no-console", help="Serve no page.")] = False,
    console_port: Annotated[int | None, typer.Option(help="TCP port of the page; 0 = any.")] = None,
    seed: Annotated[int | None, typer.Option(help="Seed of everything random.")] = None,
    log_dir: Annotated[Path, typer.Option(help="Where runs are logged.")] = Path("logs"),
    no_record: Annotated[bool, typer.Option("--no-record", help="Write no MCAP log.")] = False,
    detach: Annotated[bool, typer.Option("--detach", help="Return when ready, leave it running.")] = False,
    render: Annotated[
        Path | None, typer.Option(help="After the run, draw it: FILE.mp4, FILE.png or a folder.")
    ] = None,
    viewer: Annotated[bool, typer.Option("--viewer", help="Show the simulated robot in a window.")] = False,
    config: Annotated[Path | None, typer.Option(help="YAML configuration.")] = None,
    set_: Annotated[list[str] | None, typer.Option("--set", metavar="A.B=C", help="Set one key.")] = None,
    robot: Annotated[str | None, typer.Option(envvar=NAMED, help="Name of the robot.")] = None,
    port: Annotated[int | None, typer.Option(help="TCP port of the router, loopback.")] = None,
    resolution: Resolution = None,
    height_range: HeightRange = None,
    units: Units = None,
    up: Up = None,
    start: Annotated[
        tuple[float, float, float] | None,
        typer.Option(metavar="X Y YAW", help="Of the robot in a scene file [m, m, deg]."),
    ] = None,
) -> None:
    """Bring the whole stack up on this machine. Exit status 78 when a process was given up on the way."""
    if detach:
        _detach()
        return
    from rbtrg_robot.process.zygote import Zygote

    with Zygote(share=True) as zygote:
        from rbtrg_robot.config import ConfigError, load
        from rbtrg_robot.log.keep import prune
        from rbtrg_robot.processes import BY_NAME

        without = [*(without or []), *(["console"] if no_console else [])]
        for name in without:
            if name not in BY_NAME:
                raise ConfigError(f"there is no process {name!r}; there are {', '.join(BY_NAME)}")
        loaded = load(
            config,
            [*(set_ or ()), *([] if console_port is None else [f"console.port={console_port}"])],
            backend=backend,
            robot_model=str(Path(robot_model).resolve())
            if robot_model and Path(robot_model).is_dir()
            else robot_model,
            scene=scene,
            controller=controller,
            policy_dir=str(policy) if policy else None,
            interface=interface,
            dry_run=dry_run or None,
            viewer=viewer or None,
            map_file=str(map_file) if map_file else None,
            without=tuple(without) if without else None,
            seed=seed,
            record=False if no_record else None,
            robot=robot,
            port=port,
            scene_options=chosen(resolution, height_range, units, up, start) or None,
        )
        loaded = placed(loaded)
        if render is not None and not (loaded.simulated and loaded.record):
            raise ConfigError("--render draws the log of a simulated robot: not with --no-record or hardware")
        if loaded.viewer and not loaded.simulated:
            raise ConfigError("--viewer shows a simulated robot: only with --backend sim")
        refuse_second(loaded.robot)
        _check(loaded)
        folder = _run_folder(log_dir, loaded.scene if loaded.simulated else loaded.backend)
        loaded = loaded.model_copy(update={"log_dir": str(folder)})
        for gone in prune(folder.parent, loaded.recorder.keep_gb, spare=folder):  # makes room first
            say(f"removed {gone}: the runs took more than recorder.keep_gb = {loaded.recorder.keep_gb:g} GB")
        _write_config(folder, loaded)
        code = _supervise(loaded, zygote)
        if render is not None and not code:
            from rbtrg_robot.cli.logs import draw

            draw(folder, render)
        raise typer.Exit(code)


def placed(config: StackConfig) -> StackConfig:
    """Files with their folder, whoever named them: `goal NAME` and `log film` may be said in another one."""
    named = {key: value for key in ("scene", "map_file") if Path(value := getattr(config, key)).is_file()}
    return config.model_copy(update={key: str(Path(value).resolve()) for key, value in named.items()})


def refuse_second(robot: str) -> None:
    """Before anything is written: raises AlreadyRunning with the pid of the stack that is up."""
    from rbtrg_robot.process.runfiles import AlreadyRunning, NotRunning, read_state

    try:
        pid = int(read_state(robot)["pid"])
    except NotRunning:
        return
    raise AlreadyRunning(robot, pid)


def _check(config: StackConfig) -> None:
    """Fail now, in one line, on what would fail in a child."""
    from planning.search.door import OURS, planner_of

    if config.network.listen:
        from rbtrg_robot.access.serve import security

        security(config)
    if config.planner.method != OURS:
        planner_of(config.planner.method)
    if config.simulated:
        if importlib.util.find_spec("mujoco") is None:
            from hal.optional import INSTALL_SIMULATOR
            from rbtrg_robot.config import ConfigError

            raise ConfigError(
                f"the simulated robot is not installed: {INSTALL_SIMULATOR}; "
                "for the real one: up --backend unitree --interface NIC"
            )
        scene = config.load_scene()
        if scene.taken:
            say(f"{scene.description}; taken so: {scene.taken}")
        if scene.mesh is not None:
            scene.caster()
        config.facts.check(config.controller, config.policy_dir)
        if config.viewer:
            from hal.mujoco.view.render import require_display

            require_display()
    elif config.backend == "unitree":
        from hal.unitree.factory import check

        check(config.interface)
    else:
        from rbtrg_robot.hosts.robot import maker

        maker(config.backend)
    if config.map_file:
        from mapping.elevation.map import ElevationMap

        ElevationMap(config.elevation).load_prior(Path(config.map_file))


def _run_folder(base: Path, label: str) -> Path:
    from rbtrg_robot.log.read import LogError

    name = f"{time.strftime('%Y%m%d-%H%M%S')}_{Path(label).stem}_{os.getpid()}"
    folder = (base / name).resolve()
    try:
        folder.parent.mkdir(parents=True, exist_ok=True)
        folder.mkdir(mode=0o700)  # places, pictures and words of people are in there
    except OSError as error:
        raise LogError(f"cannot write {folder}: {error.strerror}; choose another --log-dir") from error
    return folder


def _write_config(folder: Path, config: StackConfig) -> None:
    """Into the run's folder. A robot drives without a log: a full disk is told, and what can be recorded will be."""
    path = folder / "config.yaml"
    try:
        path.write_text(config.to_yaml())
    except OSError as error:
        say(f"rbtrg-robot: cannot write {path}: {error.strerror}; make room", error=True)


def _supervise(config: StackConfig, zygote: Zygote) -> int:
    from rbtrg_robot.cli.table import Screen
    from rbtrg_robot.process.child import FATAL
    from rbtrg_robot.process.supervisor import Supervisor

    stopped: list[int] = []
    for sign in (signal.SIGINT, signal.SIGTERM, signal.SIGHUP):
        signal.signal(sign, lambda number, _frame: stopped.append(number))
    screen = Screen()
    screen.say(f"robot {config.robot!r}, backend {config.backend}, log in {config.log_dir}")
    supervisor = Supervisor(config, zygote, screen.say)
    with screen:
        supervisor.run(lambda: bool(stopped), screen.show)
    screen.say("down")
    return FATAL if supervisor.given_up else 0


def _detach() -> None:
    """The same command line without --detach, in a session of its own."""
    from rbtrg_robot.run_folder import run_dir

    arguments = [a for a in sys.argv[1:] if a != "--detach"]
    output = run_dir() / f"up-{os.getpid()}.log"
    ended: list[int] = []
    # Whoever ends this command while the stack begins would leave it without a parent: that waits until it has begun.
    for name in ENDS:
        signal.signal(name, lambda number, _frame: ended.append(number))
    with output.open("wb") as file:
        child = subprocess.Popen(
            [sys.executable, "-m", "rbtrg_robot.cli", *arguments],
            stdin=subprocess.DEVNULL,
            stdout=file,
            stderr=file,
            start_new_session=True,
        )
    ready = False
    try:
        for name in ENDS:
            signal.signal(name, lambda number, _frame: sys.exit(128 + number))
        if ended:
            sys.exit(128 + ended[0])
        ready = _wait_ready(child, output)
    finally:
        if not ready:  # also where somebody ends this command
            child.terminate()


def _wait_ready(child: subprocess.Popen[bytes], output: Path) -> bool:
    """Pass on what the stack says until it is ready. Raises typer.Exit where it ends or takes too long."""
    from rbtrg_robot.process.runfiles import NotRunning, state_of

    began, told = time.monotonic(), 0
    moved, stalled = began, ""
    while (now := time.monotonic()) - began < DETACH_LIMIT and now - moved < STALL_LIMIT:
        code = child.poll()
        if code is not None:
            say(output.read_text().strip().splitlines()[-1], error=True)
            output.unlink()
            raise typer.Exit(code or 1)
        try:
            state = state_of(child.pid)
            told = _pass_on(output, told)
            if state["ready"]:
                name = "" if state["robot"] == ROBOT else f" --robot {state['robot']}"
                say(f"running with pid {child.pid}; stop it with `rbtrg-robot down{name}`")
                output.unlink()
                return True
            stalled = state["stalled"]
        except NotRunning:
            pass
        if not stalled:
            moved = now
        with contextlib.suppress(subprocess.TimeoutExpired):
            child.wait(0.1)
    limit = STALL_LIMIT if stalled else DETACH_LIMIT
    why = stalled or f"see {output}"
    say(f"rbtrg-robot: not ready after {limit:.0f} s, ended: {why}", error=True)
    raise typer.Exit(1)


def _pass_on(output: Path, told: int) -> int:
    """Print the lines of a file but for the first `told` ones. Returns how many there are."""
    *lines, _rest = output.read_text().split("\n")
    for line in lines[told:]:
        say(line)
    return len(lines)


def down(robot: Robot = ROBOT) -> None:
    """Stop the stack of a robot. A supervisor that hangs is killed after 8 s, and every process with it."""
    import psutil

    from rbtrg_robot.process.runfiles import NotRunning, read_state

    pid = int(read_state(robot)["pid"])
    supervisor = psutil.Process(pid)
    others = supervisor.children(recursive=True)
    supervisor.terminate()
    supervisor.resume()  # one that is stopped (SIGSTOP) hears nothing else
    deadline = time.monotonic() + DOWN_LIMIT
    while time.monotonic() < deadline:
        try:
            read_state(robot)
        except NotRunning:
            say("down")
            return
        time.sleep(0.05)
    supervisor.kill()  # each process ends with it; that of the robot stops the robot first
    _, left = psutil.wait_procs(others, timeout=LEFT_LIMIT)
    for process in left:
        process.kill()
    _, left = psutil.wait_procs([supervisor, *left], timeout=LEFT_LIMIT)
    say(
        f"rbtrg-robot: the supervisor (pid {pid}) hung and was killed; is the robot standing still?",
        error=True,
    )
    if left:
        say(f"rbtrg-robot: pid {', '.join(str(p.pid) for p in left)} cannot be killed", error=True)
        raise typer.Exit(1)
    say("down")


def status(
    robot: Robot = ROBOT,
    as_json: Annotated[bool, typer.Option("--json", help="Machine-readable.")] = False,
    everybody: Annotated[bool, typer.Option("--all", help="Every robot of this computer.")] = False,
) -> None:
    """How the running stack is."""
    from rbtrg_robot.cli.link import connect
    from rbtrg_robot.cli.table import fleet, plain_console, render

    if everybody:
        known = _everybody()
        if as_json:
            say_json(known)
        else:
            plain_console().print(fleet(known))
        return
    with connect(robot) as bus:
        answer = bus.ask("status")
    if answer is None:
        from rbtrg_robot.access.identity import remote

        why = "; is this certificate still on the robot's list?" if remote() else ""
        say(f"rbtrg-robot: the supervisor does not answer{why}", error=True)
        raise typer.Exit(1)
    if as_json:
        say_json(json.loads(answer))
        return
    plain_console().print(render(json.loads(answer), topics=True))


def _everybody() -> dict[str, dict[str, Any] | None]:
    """Status of every stack. Raises NotRunning."""
    from rbtrg_robot.process.fleet import statuses
    from rbtrg_robot.process.runfiles import NotRunning

    found = statuses()
    if not found:
        raise NotRunning("no stack is running on this computer; start one with `rbtrg-robot up`")
    return found


def console(
    observer: Annotated[
        bool, typer.Option("--observer", help="For somebody who looks, and may stop.")
    ] = False,
    robot: Robot = ROBOT,
) -> None:
    """Print an address that lets one browser into the console."""
    from rbtrg_robot.process.runfiles import console_address, read_state

    read_state(robot)
    address = console_address(robot, "observer" if observer else "operator")
    if not address:
        say("rbtrg-robot: no console runs; was the stack started with --no-console?", error=True)
        raise typer.Exit(1)
    say(address)

"""`keys`."""

from __future__ import annotations

import os
import sys
from pathlib import Path
from typing import Annotated, Literal

import typer

from rbtrg_robot.terminal import say

Folder = Annotated[
    Path | None, typer.Option("--dir", help="Where the keys lie; else rbtrg/keys in XDG_CONFIG_HOME.")
]
Force = Annotated[bool, typer.Option("--force", help="Replace what exists.")]
Days = Annotated[int, typer.Option(min=1, max=36500, help="How long it is valid [days].")]
Name = Annotated[str, typer.Argument(help="Of the person: letters, digits, - and _.")]
Names = Annotated[
    list[str] | None, typer.Option(metavar="NAME", help="A person to add at once; may be repeated.")
]

keys_app = typer.Typer(help="Certificates for people on other computers.", no_args_is_help=True)


def register(app: typer.Typer) -> None:
    """Add the commands."""
    app.add_typer(keys_app, name="keys")


def _folder(folder: Path | None) -> Path:
    from rbtrg_robot.access.identity import keys_dir

    return folder or keys_dir()


def _passphrase(question: str, *, new: bool = False) -> str:
    """From the environment, else asked for at a terminal; empty where there is none."""
    from rbtrg_robot.access.certificates import PASSPHRASE

    told = os.environ.get(PASSPHRASE, "")
    if told or not sys.stdin.isatty():
        return told
    answer: str = typer.prompt(
        question, default="", hide_input=True, show_default=False, confirmation_prompt=new
    )
    return answer


@keys_app.command("init")
def keys_init(
    operator: Names = None,
    observer: Names = None,
    days: Days = 3650,
    folder: Folder = None,
    force: Force = False,
) -> None:
    """Make an authority and the robot's certificate. And one for each --operator and --observer (365 days)."""
    from rbtrg_robot.access import certificates
    from rbtrg_robot.access.identity import ROBOT
    from rbtrg_robot.topics import Role

    base = _folder(folder)
    passphrase = _passphrase("Passphrase for the key of the authority (empty: none)", new=True)
    certificates.make_authority(base, days, force=force, passphrase=passphrase)
    sealed = "encrypted" if passphrase else "not encrypted"
    say(f"{base / certificates.AUTHORITY}: the authority, its key {sealed}; keep it off the robot")
    say(f"{base / ROBOT}: for the robot's computer (network.keys)")
    for role, names in ((Role.OPERATOR, operator), (Role.OBSERVER, observer)):
        for name in names or []:
            certificates.add(base, name, role, 365, force=force, passphrase=passphrase)
            say(f"{base / name}: for the {role.value} {name}")


@keys_app.command("add")
def keys_add(
    name: Name,
    role: Annotated[Literal["operator", "observer"], typer.Option(help="What the person may do.")],
    days: Days = 365,
    folder: Folder = None,
    force: Force = False,
) -> None:
    """Make a certificate for a person and put it on the robot's list."""
    from rbtrg_robot.access import certificates
    from rbtrg_robot.access.identity import KEY
    from rbtrg_robot.topics import Role

    base = _folder(folder)
    asked = (base / certificates.AUTHORITY / KEY).is_file() and certificates.locked(base)
    passphrase = _passphrase("Passphrase of the key of the authority") if asked else ""
    made = certificates.add(base, name, Role(role), days, force=force, passphrase=passphrase)
    say(f"{made}: for the {role} {name}")
    say(_TAKES_EFFECT)


@keys_app.command("remove")
def keys_remove(name: Name, folder: Folder = None) -> None:
    """Take a person off the robot's list. The certificate does not count any more."""
    from rbtrg_robot.access import certificates

    certificates.remove(_folder(folder), name)
    say(f"{name} is off the list")
    say(_TAKES_EFFECT)


@keys_app.command("list")
def keys_list(folder: Folder = None) -> None:
    """Every certificate: until when it is valid, whether it is listed."""
    from rbtrg_robot.access import certificates
    from rbtrg_robot.access.identity import ROBOT

    base = _folder(folder)
    if not (base / ROBOT).is_dir():
        raise certificates.KeysError(f"there are no keys in {base}; `rbtrg-robot keys init` makes them")
    listed = certificates.listed(base / ROBOT)
    for file in sorted(base.glob("*/certificate.pem")):
        certificate = certificates.certificate_of(file.parent)
        name = certificates.common_name(certificate)
        here = (
            ""
            if file.parent.name in (certificates.AUTHORITY, ROBOT) or name in listed
            else "  NOT ON THE LIST"
        )
        say(f"{name:40s} until {certificate.not_valid_after_utc:%Y-%m-%d}{here}")


_TAKES_EFFECT = "it counts when the robot has the new robot/access.txt and its stack was restarted"

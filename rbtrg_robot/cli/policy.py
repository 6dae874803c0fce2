"""`policy`."""

from __future__ import annotations

from typing import Annotated

import typer

from rbtrg_robot.terminal import say

policy_app = typer.Typer(help="Learnt locomotion policies of others.", no_args_is_help=True)


def register(app: typer.Typer) -> None:
    """Add the commands."""
    app.add_typer(policy_app, name="policy")


@policy_app.command("get")
def policy_get(
    name: Annotated[str, typer.Argument(help="Of the policy: go2w_rl_sar.")],
    source: Annotated[
        str,
        typer.Option(help="Another URL that holds the repository's files; they are checked all the same."),
    ] = "",
) -> None:
    """Fetch a public policy, check it, keep it in the data folder. `--policy NAME` then finds it."""
    from hal.locomotion import public

    policy = public.published(name)
    say(f"{name} from {source or policy.source}")
    say(f"licence: {policy.licence}")
    folder, fetched = public.get(name, source)
    say(
        f"{folder}: {'fetched and checked' if fetched else 'already there, checked'}; the licence is in LICENSE"
    )

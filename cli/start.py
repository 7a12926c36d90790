"""The entry point of each command, which imports nothing first, so that Ctrl-C during imports is quiet."""

from functools import partial
from importlib import import_module


def _run(name: str) -> None:
    try:
        import_module(f"cli.{name}").main()
    except KeyboardInterrupt:
        raise SystemExit(130) from None  # as `cli.application.EXIT_INTERRUPTED`


env_assets = partial(_run, "env_assets")
mnist3d = partial(_run, "mnist3d")
realtouch = partial(_run, "realtouch")
starstruck = partial(_run, "starstruck")
tactile = partial(_run, "tactile")
tactile_envs = partial(_run, "tactile_envs")
tactile_sim = partial(_run, "tactile_sim")

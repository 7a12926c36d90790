"""Where every command starts, with nothing imported yet: Ctrl-C during the imports ends it quietly, too."""


def _run(name: str) -> None:
    try:
        from importlib import import_module

        import_module(f"cli.{name}").main()
    except KeyboardInterrupt:
        raise SystemExit(130) from None  # as `cli.application.EXIT_INTERRUPTED`


def env_assets() -> None:
    """Run ``env-assets``."""
    _run("env_assets")


def mnist3d() -> None:
    """Run ``mnist3d``."""
    _run("mnist3d")


def realtouch() -> None:
    """Run ``realtouch``."""
    _run("realtouch")


def starstruck() -> None:
    """Run ``starstruck``."""
    _run("starstruck")


def tactile_sim() -> None:
    """Run ``tactile-sim``."""
    _run("tactile_sim")

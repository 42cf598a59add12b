"""The command line: ``uwgraph COMMAND``. Heavy modules are imported by the command that needs them."""

from __future__ import annotations

import sys

import typer

from uwgraph.cli import calibrate, check, compare, demo, export, importing, mapping, places, simulate, smooth, sun
from uwgraph.cli import eval as eval_command
from uwgraph.cli.console import errors_in_words

app = typer.Typer(
    name="uwgraph",
    help="Factor-graph navigation for underwater vehicles, with the sun as the heading reference.",
    epilog="Start with: [bold]uwgraph demo[/bold]. Exit codes: 0 well, 2 usage or settings, 3 data, 4 no solution.",
    no_args_is_help=True,
    add_completion=False,
    rich_markup_mode="rich",
    pretty_exceptions_enable=False,
    context_settings={"help_option_names": ["-h", "--help"]},
)
app.command("import", epilog=importing.EXAMPLES)(importing.import_)
app.command("check", epilog=check.EXAMPLES)(check.check)
app.command("simulate", epilog=simulate.EXAMPLES)(simulate.simulate)
app.command("smooth", epilog=smooth.EXAMPLES)(smooth.smooth)
app.command("compare", epilog=compare.EXAMPLES)(compare.compare)
app.command("eval", epilog=eval_command.EXAMPLES)(eval_command.eval_)
app.command("map", epilog=mapping.EXAMPLES)(mapping.map_)
app.command("export", epilog=export.EXAMPLES)(export.export)
app.add_typer(calibrate.app, name="calibrate")
app.add_typer(sun.app, name="sun")
app.add_typer(places.app, name="places")
app.command("demo", epilog=demo.EXAMPLES)(demo.demo)


@app.command()
def version() -> None:
    """Print the version."""
    from uwgraph import __version__

    print(__version__)


@app.callback()
def _options(debug: bool = typer.Option(False, "--debug", help="Show the traceback of an error.")) -> None:
    """Options of every command; ``main`` reads ``--debug`` itself, since it acts when the command has failed."""


def main() -> None:
    """The entry point: every failure ends in a message and an exit code."""
    with errors_in_words(debug="--debug" in sys.argv[1:2]):
        app()

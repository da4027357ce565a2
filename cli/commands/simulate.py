"""``tiler simulate``."""

from __future__ import annotations

from dataclasses import asdict

import click

from cli.options import json_option
from cli.output import print_facts, print_json, print_table
from cli.session import TilerCommand, current_session, shown_progress


def _list_scenes(context: click.Context, parameter: click.Parameter, wanted: bool) -> None:
    if not wanted:
        return
    from tiler.simulate import SCENES, SITES

    sites = [(name, (make.__doc__ or "").splitlines()[0]) for name, make in SITES.items()]
    print_table("Kinds of places, of any size and seed", ("name", "what"), sites)
    rows = [(s.name, s.kind, str(s.seed), f"{s.side_m:g}", s.summary) for s in SCENES.values()]
    print_table(
        "Scenes that methods are tuned and scored on",
        ("name", "kind", "seed", "size m", "what"),
        rows,
    )
    context.exit()


@click.command("simulate", cls=TilerCommand, progress=True)
@click.argument("out", metavar="OUT.laz", type=click.Path())
@click.option(
    "--kind",
    type=click.Choice(["als", "dim"]),
    help="source of the cloud: laser scanning (als) or dense image matching (dim) [default: the kind of the scene, "
    "else als]",
)
@click.option(
    "--scene",
    default="city",
    metavar="NAME",
    help="kind of place, or scene of the catalogue; --list shows them [default: city]",
)
@click.option(
    "--list",
    is_flag=True,
    is_eager=True,
    expose_value=False,
    callback=_list_scenes,
    help="list the scenes and exit [default: no]",
)
@click.option(
    "--seed",
    type=click.IntRange(min=0),
    metavar="N",
    help="seed of the scene; the same seed and settings give the same bytes [default: the seed of the scene, else 1]",
)
@click.option(
    "--size",
    metavar="LENGTH",
    help="side of the square, or extent from west to east of a place with water [unit: m; default: the side of "
    "the scene, else 500 (als) or 150 (dim)]",
)
@click.option(
    "--density",
    type=float,
    metavar="N",
    help="density of pulses (als) or points (dim) on open ground [unit: per m2; default: the density of the scene, "
    "else 4 (als) or 40 (dim)]",
)
@click.option(
    "--sigma",
    metavar="LENGTH",
    help="standard deviation of the heights [unit: m; default: the value of the scene, else 0.025 (als) "
    "or 0.066 (dim)]",
)
@click.option(
    "--blunders",
    default=1.0,
    type=float,
    metavar="N",
    help="number of points far below and above the ground, as a multiple of the usual number [default: 1]",
)
@click.option(
    "--resolution",
    default="1",
    metavar="LENGTH",
    help="pixel size of the reference terrain model [unit: m; default: 1]",
)
@json_option
def command(
    out: str,
    kind: str | None,
    scene: str,
    seed: int | None,
    size: str | None,
    density: float | None,
    sigma: str | None,
    blunders: float,
    resolution: str,
    as_json: bool,
) -> None:
    """Simulate a cloud with reference classes and terrain.

    OUT.laz gets the points of a simulated place with their ASPRS classes. Class 1 is cars and
    garden walls, 2 ground, 6 buildings and facades, 9 water, 14 wires, 15 towers and 17
    bridges. Classes 3, 4 and 5 are plants below 1 m, below 3 m and higher. Classes 7 and 18 are
    blunders below the ground and in the air. OUT_dtm.tif next to OUT.laz gets the reference
    terrain, also below objects. The cloud is simulated patch by patch, so memory does not limit
    its size.
    """
    from tiler.core.units import parse_length
    from tiler.simulate.files import describe_scene, write_scene

    def metres(text: str | None) -> float | None:
        return None if text is None else float(parse_length(text))

    spec = describe_scene(
        scene,
        kind,
        seed=seed,
        side_m=metres(size),
        density=density,
        sigma_m=metres(sigma),
        blunders=blunders,
    )
    with shown_progress() as listener:
        written = write_scene(out, spec, float(parse_length(resolution)), listener)
    if as_json:
        print_json(asdict(written))
    elif not current_session().quiet:
        print_facts(asdict(written))

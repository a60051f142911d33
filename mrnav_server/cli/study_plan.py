"""``mrnav study new``, ``status`` and ``tell``: the plan, where it stands, what participants tell."""

import json
from collections import Counter
from pathlib import Path
from typing import Annotated, Any

import typer
from rich.console import Console
from rich.table import Table

from mrnav_server.core.errors import ConfigError
from mrnav_server.vision.model_store import find_model, model_names


def named_models(texts: list[str] | None) -> list[str]:
    """Return the vessel models that were named, one or several with commas in between; all without a name.

    Raises:
        ConfigError: If there is no such model.
    """
    names = [name for text in texts or [] for name in text.split(",") if name] or model_names()
    for name in names:
        find_model(name)
    return names


def new(
    folder: Annotated[Path, typer.Argument(help="The study's folder.")],
    participants: Annotated[int, typer.Option(help="How many.")],
    models: Annotated[
        list[str] | None, typer.Option(help="Vessel models, with commas or repeated; all if left out.")
    ] = None,
    repetitions: Annotated[int, typer.Option(help="Trials of each model in each condition.")] = 2,
    seed: Annotated[int, typer.Option(help="Of the counter-balanced order.")] = 0,
    training_min: Annotated[float, typer.Option(min=0.0, help="Training before each condition.")] = 5.0,
    json_output: Annotated[bool, typer.Option("--json", help="Print one JSON object.")] = False,
) -> None:
    """Plan a study: both conditions for everybody, in a counter-balanced order."""
    from mrnav_server.study.plan import new_plan
    from mrnav_server.study.study_folder import StudyFolder

    plan = new_plan(participants, named_models(models), repetitions, seed, training_s=60.0 * training_min)
    study = StudyFolder.create(folder, plan)
    if json_output:
        typer.echo(json.dumps(status_fields(study.folder)))
        return
    trials = sum(step.kind == "trial" for step in plan.steps)
    typer.echo(f"{folder}: {participants} participants, {trials} trials; lead it with")
    typer.echo(f"  mrnav serve --study {folder}")


def status(
    folder: Annotated[Path, typer.Argument(help="The study's folder.")],
    json_output: Annotated[bool, typer.Option("--json", help="Print one JSON object.")] = False,
) -> None:
    """Tell what is done, what was interrupted and what comes next."""
    found = status_fields(folder)
    if json_output:
        typer.echo(json.dumps(found))
        return
    simulated = found["operator_kind"] == "simulated"
    title = f"{folder}: {found['trials_done']} of {found['trials']} trials"
    table = Table(title=title + (" (simulated)" if simulated else ""), title_justify="left")
    for column in ("simulated operator" if simulated else "participant", "done", "interrupted", "next"):
        table.add_column(column)
    for code, each in found["codes"].items():
        table.add_row(code, f"{each['done']} of {each['steps']}", str(each["interrupted"]), each["next"])
    Console().print(table)
    if found["next"] is not None:
        Console().print(f"next: {describe(found['next'])}", markup=False)


def tell(
    folder: Annotated[Path, typer.Argument(help="The study's folder.")],
    code: Annotated[str, typer.Argument(help="The participant's code, for example P01.")],
    age: Annotated[int | None, typer.Option(help="In years.")] = None,
    sex: Annotated[str | None, typer.Option(help="female, male or diverse.")] = None,
    mr: Annotated[str | None, typer.Option(help="Experience with mixed reality: none, some, much.")] = None,
    micromanipulation: Annotated[
        str | None, typer.Option(help="Experience with micromanipulators: none, some, much.")
    ] = None,
) -> None:
    """Keep what a participant tells of himself or herself; all of it is optional, and none of it a name."""
    from pydantic import TypeAdapter, ValidationError

    from mrnav_server.study.demographics import Demographics, keep_demographics
    from mrnav_server.study.study_folder import StudyFolder

    plan = StudyFolder(folder).plan
    if plan.operator_kind == "simulated":
        raise ConfigError("simulated operators have neither age nor experience")
    if code not in plan.codes:
        raise ConfigError(f"the plan has no {code}: there are {', '.join(plan.codes)}")
    given = {
        "age_years": age,
        "sex": sex,
        "mr_experience": mr,
        "micromanipulation_experience": micromanipulation,
    }
    try:
        told = TypeAdapter(Demographics).validate_python(given)
    except ValidationError as error:
        first = error.errors(include_url=False)[0]
        raise ConfigError(f"{first['loc'][0]}: {first['msg']}") from None
    keep_demographics(folder, code, told)


def describe(step: dict[str, Any]) -> str:
    """Return a step in a few words."""
    what = f"{step['kind']} {step['repetition']}" if step["repetition"] else step["kind"]
    return f"{step['code']}, {what}, {step['condition'].replace('_', ' ')}, {step['model']}"


def status_fields(folder: Path) -> dict[str, Any]:
    """Return where a study stands, ready for JSON.

    Raises:
        ConfigError: If it is none.
    """
    from dataclasses import asdict

    from mrnav_server.study.study_folder import StudyFolder

    study = StudyFolder(folder)
    plan, upcoming = study.plan, study.next_step
    codes: dict[str, Any] = {}
    for code in plan.codes:
        own = [step for step in plan.steps if step.code == code]
        left = [step for step in own if study.progress(step).status != "done"]
        codes[code] = {
            "steps": len(own),
            "done": len(own) - len(left),
            "interrupted": sum(study.progress(step).interrupted for step in own),
            "next": left[0].id if left else "",
        }
    trials = Counter(study.progress(step).status for step in plan.steps if step.kind == "trial")
    return {
        "operator_kind": plan.operator_kind,
        "models": list(plan.models),
        "repetitions": plan.repetitions,
        "seed": plan.seed,
        "trials": trials.total(),
        "trials_done": trials["done"],
        "codes": codes,
        "next": asdict(upcoming) if upcoming else None,
    }

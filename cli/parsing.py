"""Command lines from frozen dataclasses: help with bounds, one line for an error."""

import argparse
import dataclasses
import re
import warnings
from collections.abc import Iterable, Sequence
from difflib import get_close_matches
from importlib import import_module
from pathlib import Path
from typing import Annotated, Any, Generic, Literal, TypeVar, get_args, get_origin, get_type_hints

import tyro
from tyro import _errors as tyro_errors  # the one way to a single line; hence the bound in pyproject.toml
from tyro.constructors import ConstructorRegistry, StructConstructorSpec, StructFieldSpec, StructTypeInfo

from laploop.configuration import allowed, alternatives, field_docs
from laploop.errors import UsageError

Arguments = TypeVar("Arguments")

Inlined = Annotated[Arguments, tyro.conf.arg(name="")]
"""A dataclass whose fields are options of the command, without a prefix."""
OutputPath = Annotated[Path, tyro.conf.arg(help="Folder to write to; made where it does not exist.")]


@dataclasses.dataclass(frozen=True, kw_only=True)
class Option:
    """An option of a command, in the words of its help."""

    names: tuple[str, ...]
    """With their dashes; none where it is found by its place."""
    values: str
    """What may follow; empty for a switch."""
    meaning: str
    """With its bounds."""
    default: str
    """Empty where there is none."""
    required: bool


def arguments_class(command: str) -> type:
    """Return the dataclass that holds a command's arguments."""
    module = import_module(f"laploop.cli.commands.{command.replace('-', '_')}")
    found: type = getattr(module, f"{command.title().replace('-', '')}Arguments")
    return found


def parse(kind: type[Arguments], arguments: Sequence[str], command: str, default: Arguments | None = None) -> Arguments:
    """Read a command's arguments into a dataclass, where no option says otherwise from `default` or the fields' defaults.

    Raises:
        LaploopError: If a value is not allowed, or an option is unknown, missing or of the wrong type.
    """
    chosen, rest = parse_known(kind, arguments, command, default)
    if rest:
        raise unknown_option(rest[0], option_names(kind))
    return chosen


def parse_known(
    kind: type[Arguments], arguments: Sequence[str], command: str, default: Arguments | None = None
) -> tuple[Arguments, list[str]]:
    """Read a command's arguments as `parse` does; return with them what it does not know, in its order."""

    def refuse(event: tyro_errors.ParseErrorEvent) -> None:
        raise _in_one_line(event, arguments)

    with BOUNDS_IN_HELP, tyro_errors.on_parse_error(refuse):
        given: Any = tyro.MISSING_NONPROP if default is None else default
        return tyro.cli(kind, args=list(arguments), prog=f"laploop {command}", default=given, return_unknown_args=True)


def options_of(kind: type) -> list[Option]:
    """Return all options of a command."""
    with BOUNDS_IN_HELP, warnings.catch_warnings():
        # Nothing else hands out the parser; hence the bound in pyproject.toml.
        warnings.simplefilter("ignore", DeprecationWarning)
        actions = tyro.extras.get_parser(kind)._actions  # noqa: SLF001  argparse has no other way to see them
    return [_option(action) for action in actions if "--help" not in action.option_strings]


def option_names(kind: type) -> list[str]:
    """Return the names of all options of a command, with their dashes."""
    return [name for option in options_of(kind) for name in option.names]


def _option(action: argparse.Action) -> Option:
    text = " ".join((action.help or "").split())
    hint = re.search(r" ?\((required|default: .*)\)$", text)
    return Option(
        names=tuple(action.option_strings),
        values=str(action.metavar or ""),
        meaning=text if hint is None else text[: hint.start()],
        default="" if hint is None else hint[1].partition("default: ")[2],
        required=action.required,
    )


def unknown_option(token: str, options: Iterable[str]) -> UsageError:
    """Return the error for an option, or another word, that a command does not know; names the nearest option."""
    name = token.partition("=")[0]
    if not name.startswith("-"):
        return UsageError(f"unexpected {token!r}; every value follows the name of its option")
    nearest = get_close_matches(name, list(options), n=1)
    hint = f"did you mean {nearest[0]}?" if nearest else "--help lists all"
    return UsageError(f"unknown option {name}; {hint}")


def _in_one_line(event: tyro_errors.ParseErrorEvent, arguments: Sequence[str]) -> UsageError:
    if isinstance(event, tyro_errors.MissingArgs):
        missing = [_name(one.arg) for one in event.missing_arguments]
        misspelt = [token for token in event.unrecognized_tokens if get_close_matches(token, missing)]
        return unknown_option(misspelt[0], missing) if misspelt else UsageError(f"{', '.join(missing)} must be given")
    argument = getattr(event, "argument", None)
    if argument is None:
        return UsageError(" ".join(str(getattr(event, "message", event)).split()))
    wanted = str(argument.lowered.metavar)
    wanted = wanted[1:-1].replace(",", ", ") if wanted.startswith("{") else wanted
    given = _given(arguments, _name(argument)) if _name(argument).startswith("-") else [*arguments[:1]]
    if not given:
        return UsageError(f"{_name(argument)} needs a value: {wanted}")
    return UsageError(f"{_name(argument)} is {' '.join(given)!r}; allowed: {wanted}")


def _name(argument: Any) -> str:
    return str(argument.lowered.name_or_flags[-1])


def _given(arguments: Sequence[str], name: str) -> list[str]:
    """Return the words that follow an option."""
    values: list[str] = []
    for number, token in enumerate(arguments):
        option, equals, value = token.partition("=")
        if option.replace("_", "-") != name:
            continue
        values = [value] if equals else []
        for following in arguments[number + 1 :]:
            if equals or following.startswith("--"):
                break
            values.append(following)
    return values


def _without_none(annotation: Any) -> Any:
    """Return how to show an option that may be left out: nobody gives it None."""
    others = [one for one in alternatives(annotation) if one is not type(None)]
    names = [get_args(one)[0] if get_origin(one) is Annotated else one for one in others]
    words = [f"{{{','.join(get_args(one))}}}" if get_origin(one) is Literal else one.__name__.upper() for one in names]
    return tyro.conf.arg(metavar="|".join(words), help_behavior_hint="")


BOUNDS_IN_HELP = ConstructorRegistry()
"""How tyro reads our dataclasses: with the bounds behind the docstrings."""


@BOUNDS_IN_HELP.struct_rule
def _dataclass_rule(info: StructTypeInfo) -> StructConstructorSpec | None:
    """Take dataclasses as tyro does, with the bounds behind the docstrings; leave it those whose fields have open types."""
    if not dataclasses.is_dataclass(info.type) or Generic in info.type.__mro__:
        return None
    kind: Any = info.type
    hints, docs = get_type_hints(kind, include_extras=True), field_docs(kind)
    fields = []
    for field in dataclasses.fields(kind):
        default: Any = tyro.MISSING
        if isinstance(info.default, kind):
            default = getattr(info.default, field.name)
        elif field.default is not dataclasses.MISSING:
            default = field.default
        elif field.default_factory is not dataclasses.MISSING:
            default = field.default_factory()
        bounds = allowed(kind, (field.name,)).removesuffix(", or none")
        bounded = re.search(r" to |above|below|at (least|most)", bounds)
        text = " ".join([*docs.get(field.name, "").split(), *([f"({bounds})"] if bounded else [])])
        hint = hints[field.name]
        shown: Any = hint if default is not None else Annotated[hint, _without_none(hint)]
        fields.append(StructFieldSpec(name=field.name, type=shown, default=default, helptext=text))
    return StructConstructorSpec(instantiate=kind, fields=tuple(fields))

"""Commands and groups of them: how they read their options, and show them in the help."""

from typing import Any

import typer


class Command(typer.core.TyperCommand):
    """A command that takes an option of one value once; Click would take its last value."""

    def parse_args(self, ctx: Any, args: list[str]) -> list[str]:  # noqa: ANN401 - Click's own
        """Read the options; reject one of one value that is there twice."""
        words = list(args)  # which the parser removes
        rest = super().parse_args(ctx, args)
        given: list[Any] = self.make_parser(ctx).parse_args(words)[2]
        for parameter in given:
            if _has_one_value(parameter) and given.count(parameter) > 1:
                raise typer.BadParameter(
                    "it is given more than once, wanted one value", ctx, parameter
                )
        return rest

    def get_params(self, ctx: Any) -> list[Any]:  # noqa: ANN401 - Click's own
        """Return the options and arguments, flags without the type that Typer shows."""
        return _without_types_of_flags(super().get_params(ctx))


class Group(typer.core.TyperGroup):
    """A group of commands."""

    def get_params(self, ctx: Any) -> list[Any]:  # noqa: ANN401 - Click's own
        """Return the options and arguments, flags without the type that Typer shows."""
        return _without_types_of_flags(super().get_params(ctx))


def _has_one_value(parameter: Any) -> bool:  # noqa: ANN401 - Click's own
    return not (getattr(parameter, "is_flag", True) or parameter.multiple)


def _without_types_of_flags(parameters: list[Any]) -> list[Any]:
    """Return options of which the help shows no type where they take no value."""
    for parameter in parameters:
        if getattr(parameter, "is_flag", False):
            parameter.metavar = ""
    return parameters

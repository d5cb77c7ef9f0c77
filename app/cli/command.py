"""How commands read their options."""

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


def _has_one_value(parameter: Any) -> bool:  # noqa: ANN401 - Click's own
    return not (getattr(parameter, "is_flag", True) or parameter.multiple)

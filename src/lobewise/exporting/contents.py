"""The contents of an export: its functions, its binaries, its frame."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

from lobewise.exporting.arguments import Argument
from lobewise.exporting.plan import FilterPlan
from lobewise.exporting.sample import Sample


@dataclass(frozen=True)
class Function:
    """A compiled function: its name in C, what it does, and its arguments in order."""

    name: str
    title: str
    arguments: Sequence[Argument]


@dataclass(frozen=True)
class Contents:
    """Everything that the files of an export are made from."""

    plan: FilterPlan
    name: str
    """Prefix of files and functions."""
    target: str
    """Halide's full name of the target."""
    sample: Sample
    """The frame of the example."""

    @property
    def title(self) -> str:
        """The filter in half a line."""
        plan = self.plan
        lobes = f" of {plan.lobes}" if plan.is_mixture else ""
        reach = "" if plan.form == "atrous" else f", radius {plan.radius}"
        return f"lobewise filter, {plan.similarity}{lobes}, {plan.form}{reach}"

    @property
    def functions(self) -> list[Function]:
        """The filter and, if it compares lobes, the function that makes them."""
        found = [Function(f"{self.name}_filter", "Filters a frame.", self.plan.filter_arguments)]
        if self.plan.makes_lobes:
            title = "Makes the lobes that the filter compares, and its mask, from what a G-buffer holds."
            found.append(Function(f"{self.name}_lobes", title, self.plan.lobe_arguments))
        return found

    @property
    def binaries(self) -> list[str]:
        """The file of each of the `functions`. The filter's file also holds Halide's runtime."""
        windows = "windows" in self.target
        found = [f"{self.name}.lib" if windows else f"lib{self.name}.a"]
        return found + ([f"{self.name}_lobes.{'obj' if windows else 'o'}"] if self.plan.makes_lobes else [])

    @property
    def frame(self) -> list[Argument]:
        """The images that frame.raw holds, in order: the inputs that no function makes."""
        every = [argument for function in self.functions for argument in function.arguments]
        made = {argument.name for argument in every if argument.role == "output"}
        given: dict[str, Argument] = {}
        for argument in every:
            if argument.role == "input" and argument.name not in made:
                given.setdefault(argument.name, argument)
        return list(given.values())

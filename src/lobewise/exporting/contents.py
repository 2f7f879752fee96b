"""What an export consists of: its functions, its binaries, its frame."""

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
    """What stands in the folder of an export."""

    plan: FilterPlan
    """The filter."""
    name: str
    """What files and functions begin with."""
    target: str
    """What it is compiled for, in full."""
    sample: Sample
    """The frame of the example."""

    @property
    def title(self) -> str:
        """What the filter is, in half a line."""
        plan = self.plan
        lobes = f" of {plan.lobes}" if plan.similarity == "sg_mixture" else ""
        reach = "" if plan.form == "atrous" else f", radius {plan.radius}"
        return f"lobewise filter, {plan.similarity}{lobes}, {plan.form}{reach}"

    @property
    def functions(self) -> list[Function]:
        """The filter, and what makes its lobes where it compares some."""
        found = [Function(f"{self.name}_filter", "Filters a frame.", self.plan.filter_arguments)]
        if self.plan.makes_lobes:
            title = "Makes the lobes that the filter compares, and its mask, from what a G-buffer holds."
            found.append(Function(f"{self.name}_lobes", title, self.plan.lobe_arguments))
        return found

    @property
    def binaries(self) -> list[str]:
        """The files of `functions`; that of the filter has Halide's runtime."""
        windows = "windows" in self.target
        found = [f"{self.name}.lib" if windows else f"lib{self.name}.a"]
        return found + ([f"{self.name}_lobes.{'obj' if windows else 'o'}"] if self.plan.makes_lobes else [])

    @property
    def frame(self) -> list[Argument]:
        """The images that frame.raw holds, in order: those that neither function makes."""
        every = [argument for function in self.functions for argument in function.arguments]
        made = {argument.name for argument in every if argument.role == "output"}
        given: dict[str, Argument] = {}
        for argument in every:
            if argument.role == "input" and argument.name not in made:
                given.setdefault(argument.name, argument)
        return list(given.values())

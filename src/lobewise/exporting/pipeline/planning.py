"""Make the pipeline of some settings: take the plan of the recipe, and add a call for each of its steps."""

from __future__ import annotations

from lobewise import engine
from lobewise.denoising.planning.frame_plans import FrameTraits, plan_frame
from lobewise.denoising.planning.layer_plans import LayerTraits
from lobewise.engine.graph import Graph
from lobewise.engine.recorder import Recorder
from lobewise.exporting.pipeline.driver import Pipeline
from lobewise.exporting.pipeline.recipes.constants import Constants
from lobewise.exporting.pipeline.recipes.frames import PlannedFrame
from lobewise.exporting.pipeline.recipes.guides import Features, PipelineGuides, no_features
from lobewise.exporting.pipeline.settings import PipelineSettings
from lobewise.exporting.targets import get_gpu_api, parse_target, refuse_target
from lobewise.settings.choices import get_quality


def make_pipeline(
    settings: PipelineSettings,
    *,
    target: str = "host",
    name: str = "lobewise",
    constants: Constants | None = None,
    features: Features = no_features,
) -> Pipeline:
    """Return the pipeline of some settings; nothing is compiled yet.

    Parameters
    ----------
    settings : PipelineSettings
    target : str
        A processor; see `lobewise.exporting.targets.parse_target`.
    name : str
        Beginning of the names of files and functions.
    constants : Constants, optional
        Others than those of the usual example values. The program does not depend on them.
    features : callable
        As of `lobewise.exporting.pipeline.writing.export_pipeline`.

    Raises
    ------
    InputError, DeviceError
        If the target cannot be used.
    """
    if get_gpu_api(target) is not None:
        raise refuse_target(
            target, "a graphics processor, which a pipeline does not run on: leave --plan out, or name a processor"
        )
    chosen = parse_target(target)
    guided = get_quality(settings.plan).reads_halves
    constants = constants or Constants(settings.upsample, settings.radius, guided)
    graph = Graph(stage="guides")
    guides = PipelineGuides(settings, graph, Recorder(graph, chosen, name), constants, features)
    traits = {each: LayerTraits(is_diffuse=each == "diffuse") for each in settings.layer_names}
    plan = plan_frame(FrameTraits(traits), settings.resolve())
    with engine.use(guides.kernels):
        PlannedFrame(guides, plan).run()
    read = {image.memory.name for operation in graph.operations for image in operation.reads}
    unread = [before.name for _, before in graph.kept if before.name not in read]
    assert not unread, f"no step reads what the frame before has left: {unread}"
    kernels = guides.kernels
    return Pipeline(settings, graph, constants, list(kernels.found.values()), kernels.lanes, name, chosen.to_string())

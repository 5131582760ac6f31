"""The coupled scene: what it says, the model made of it, its state, and one step of the pipeline.

SceneSpec -> build -> HapticModel -> step(model, state, posed, t0, t1) -> what observers see.
"""

"""What a scene uses of a material: stub."""

class SceneUse:
    pass

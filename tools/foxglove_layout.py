"""Write docs/assets/foxglove_layout.json: map, points, outline, tracks and alarms of the agent ``ego`` in Foxglove."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

PLACE = Path(__file__).resolve().parents[1] / "docs" / "assets" / "foxglove_layout.json"


def layout(agent: str = "ego") -> dict[str, Any]:
    """Return the layout as written by Foxglove's SDK."""
    from foxglove import layouts as fox

    grid = fox.BaseRendererGridTopicSettings(
        visible=True, color_mode="gradient", color_field="visibility", gradient=("#40404080", "#30c090a0"),
        min_value=0.0, max_value=100.0, draw_behind=True, frame_locked=True,
    )  # fmt: skip
    points = fox.BaseRendererPointCloudTopicSettings(
        visible=True, color_mode="colormap", color_field="z", color_map="turbo", point_size=2.0
    )
    view = fox.ThreeDeePanel(
        title="What the LiDAR sees",
        config=fox.ThreeDeeConfig(
            follow_tf=f"{agent}/level", follow_mode="follow-pose",
            camera_state=fox.ThreeDeeCameraState(distance=110.0, phi=35.0, theta_offset=90.0, perspective=True),
            topics={
                f"/{agent}/lidar/fov": grid,
                f"/{agent}/lidar/data": points,
                f"/{agent}/lidar/scene": fox.BaseRendererSceneUpdateTopicSettings(visible=True),
                f"/{agent}/lidar/objects": fox.BaseRendererSceneUpdateTopicSettings(visible=True),
                "/command_center/objects": fox.BaseRendererSceneUpdateTopicSettings(visible=True),
            },
        ),
    )  # fmt: skip
    log = fox.LogPanel(title="Alarms", config=fox.LogConfig(topic_to_render="/log", min_log_level=1))
    parts = [fox.SplitItem(proportion=4, content=view), fox.SplitItem(proportion=1, content=log)]
    tree: dict[str, Any] = json.loads(fox.Layout(content=fox.SplitContainer(direction="column", items=parts)).to_json())
    return tree


if __name__ == "__main__":
    PLACE.write_text(json.dumps(layout(), indent=1) + "\n", encoding="utf-8")

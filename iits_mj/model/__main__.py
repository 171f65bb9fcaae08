"""Re-makes what is derived from `mjcf/truck.toml`: `python -m iits_mj.model`."""

from iits_mj.core.assets import mjcf_dir
from iits_mj.model.export import write_model

write_model(mjcf_dir())

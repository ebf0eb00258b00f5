"""A virtual rig and panel with known truth, ray-traced; makes scene folders."""

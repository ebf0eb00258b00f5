"""Taking a scan: patterns on a second screen, two cameras, scene folders. Nothing else depends on it."""

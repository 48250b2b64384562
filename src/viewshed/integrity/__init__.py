"""④ Integrity: monitors that say when an estimate is to be doubted."""

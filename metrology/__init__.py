"""The science: pure functions and small frozen dataclasses on arrays; knows no disk and no Prefect."""

import sys
from pathlib import Path

LOAD = Path(__file__).resolve().parents[3] / "clients" / "load"
sys.path.insert(0, str(LOAD))  # scripts that stand alone, not an installed package

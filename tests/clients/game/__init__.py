import sys
from pathlib import Path

GAME = Path(__file__).resolve().parents[3] / "clients" / "game"
sys.path.insert(0, str(GAME))  # a program that stands alone, not an installed package

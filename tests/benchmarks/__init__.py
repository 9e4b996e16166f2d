from tests.clients.load import LOAD

__all__ = ["LOAD"]

level: str
version: str
compiler: str
eigen: str

def num_threads() -> int: ...
def set_num_threads(threads: int) -> None: ...

"""Worker processes that compute, so that a service's event loop never does."""

from common.workers.template import Template
from common.workers.warm import WarmWorker
from common.workers.worker import Worker, WorkerError

__all__ = ["Template", "WarmWorker", "Worker", "WorkerError"]

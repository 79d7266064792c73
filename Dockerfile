# One image for every service; `docker compose up` starts a cluster of them.
ARG BASE_IMAGE=python:3.11-slim-bookworm

FROM ${BASE_IMAGE} AS build
ENV PIP_DISABLE_PIP_VERSION_CHECK=1 PIP_NO_CACHE_DIR=1
RUN python3 -m venv /opt/recslam
WORKDIR /src
COPY pyproject.toml constraints.txt README.md ./
# Dependencies have a layer of their own: a change of our code does not fetch them again.
RUN mkdir services common && touch services/__init__.py common/__init__.py \
    && /opt/recslam/bin/pip install -q -c constraints.txt ".[all]" \
    && /opt/recslam/bin/pip uninstall -q -y recslam
COPY common common
COPY services services
RUN /opt/recslam/bin/pip install -q --no-deps .

FROM ${BASE_IMAGE}
RUN useradd --uid 10001 --create-home recslam \
    && mkdir -p /maps /var/lib/recslam /var/cache/numba \
    && chown recslam: /maps /var/lib/recslam /var/cache/numba
COPY --from=build /opt/recslam /opt/recslam
ENV PATH=/opt/recslam/bin:$PATH \
    PYTHONUNBUFFERED=1 \
    NUMBA_CACHE_DIR=/var/cache/numba \
    OMP_NUM_THREADS=1 OPENBLAS_NUM_THREADS=1 MKL_NUM_THREADS=1
USER recslam
WORKDIR /var/lib/recslam
# Compiled as the user who runs it; on a processor of another kind the first run compiles again.
RUN recslam warmup
ENTRYPOINT ["recslam"]
CMD ["--help"]

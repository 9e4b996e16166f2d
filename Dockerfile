# One image for servers and workers: `adverb serve` and `adverb worker`.

FROM node:22-slim AS dashboard
WORKDIR /src/clients/dashboard
COPY clients/dashboard/package.json clients/dashboard/package-lock.json ./
RUN npm ci
COPY clients/typescript /src/clients/typescript
COPY clients/dashboard ./
RUN npm run build

FROM python:3.11-slim AS build
ENV PIP_NO_CACHE_DIR=1 PIP_DISABLE_PIP_VERSION_CHECK=1
RUN python -m venv /opt/adverb && pip install hatchling
COPY requirements.runtime.lock /src/
RUN /opt/adverb/bin/pip install --require-hashes -r /src/requirements.runtime.lock
COPY pyproject.toml README.md LICENSE /src/
COPY verbs /src/verbs
COPY service /src/service
COPY --from=dashboard /src/service/static /src/service/static
RUN pip wheel --no-deps --no-build-isolation --wheel-dir /wheels /src \
    && /opt/adverb/bin/pip install --no-deps /wheels/*.whl
# Kernels for any processor of this architecture. Without this they fit the building machine only, and other machines
# compile them again at the start, for minutes.
ENV NUMBA_CPU_NAME=generic OPENBLAS_NUM_THREADS=1
RUN NUMBA_CACHE_DIR=/opt/adverb/kernels /opt/adverb/bin/python -m service.run.warmup
COPY deploy/start /opt/adverb/bin/start

FROM python:3.11-slim
RUN groupadd --gid 10001 adverb \
    && useradd --uid 10001 --gid 10001 --no-create-home --shell /usr/sbin/nologin adverb \
    && install -d -o 10001 -g 10001 /verbs \
    && install -d -m 1777 /data
# A tmpfs on /data belongs to root and gets the mode of the folder in the image, so that has to be open to the user.
COPY --from=build /opt/adverb /opt/adverb
ENV PATH=/opt/adverb/bin:$PATH \
    PYTHONDONTWRITEBYTECODE=1 \
    OPENBLAS_NUM_THREADS=1 \
    NUMBA_CPU_NAME=generic \
    NUMBA_CACHE_DIR=/tmp/kernels \
    ADVERB_HOST=0.0.0.0 \
    ADVERB_PORT=8000 \
    ADVERB_DATA=/data \
    ADVERB_LOG_JSON=true
USER 10001:10001
EXPOSE 8000
STOPSIGNAL SIGTERM
HEALTHCHECK --interval=10s --timeout=5s --start-period=60s --retries=3 \
    CMD ["python", "-c", "from urllib.request import urlopen; urlopen('http://127.0.0.1:8000/readyz', timeout=4)"]
ENTRYPOINT ["start"]
CMD ["adverb", "serve"]

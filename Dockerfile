# syntax=docker/dockerfile:1
# docker build -t rholoc .        The server:  docker run -p 8080:8080 -v maps:/maps -v data:/data rholoc
#                                 A worker:    docker run -v maps:/maps -v data:/data rholoc worker
#
# Any glibc image with Python 3.11 or later, its venv module and useradd may be the base:
#   docker build --build-arg BASE=registry.example/python:3.12-slim .
ARG BASE=python:3.11-slim

FROM ${BASE} AS builder
# pip's own configuration for the build, e.g. --build-arg PIP_INDEX_URL=…; none of it ends up in the image.
ARG PIP_INDEX_URL
ARG PIP_EXTRA_INDEX_URL
ARG PIP_FIND_LINKS
ARG PIP_TRUSTED_HOST
ARG PIP_CERT
ENV PIP_CONSTRAINT=/src/server/constraints.txt PIP_NO_CACHE_DIR=1 PIP_DISABLE_PIP_VERSION_CHECK=1
WORKDIR /src
RUN python3 -m venv /opt/rholoc
# Dependencies first: they change less often than the source.
COPY pyproject.toml server/constraints.txt /src/server/
COPY client/pyproject.toml /src/client/
RUN python3 -c "import tomllib; \
server, client = (tomllib.load(open(of + '/pyproject.toml', 'rb'))['project'] for of in ('server', 'client')); \
extras = server['optional-dependencies']; \
needed = [*server['dependencies'], *extras['server'], *extras['telemetry'], *extras['grids'], *client['dependencies']]; \
print(*(name for name in needed if not name.startswith('rholoc-client')), sep='\n')" \
        > /tmp/requirements.txt \
    && /opt/rholoc/bin/pip install -r /tmp/requirements.txt
COPY pyproject.toml README.md LICENSE ./
COPY server server
COPY client client
RUN /opt/rholoc/bin/pip install --no-deps ./client . \
    && /opt/rholoc/bin/python -m compileall -q /opt/rholoc/lib \
    && /opt/rholoc/bin/pip uninstall -y pip setuptools

FROM ${BASE}
# /maps and /data belong to the user that runs the service; a new volume takes over what is in them here.
RUN groupadd --gid 10001 rholoc \
    && useradd --uid 10001 --gid 10001 --home-dir /data --no-create-home --shell /usr/sbin/nologin rholoc \
    && install -d -o rholoc -g rholoc /maps /data
COPY --from=builder /opt/rholoc /opt/rholoc
COPY --chown=rholoc:rholoc maps /maps
ENV PATH=/opt/rholoc/bin:$PATH \
    PYTHONUNBUFFERED=1 \
    MPLCONFIGDIR=/tmp/matplotlib \
    RHOLOC_MAPS_DIR=/maps \
    RHOLOC_DATA_DIR=/data \
    RHOLOC_HOST=0.0.0.0 \
    RHOLOC_PORT=8080
USER rholoc
WORKDIR /data
VOLUME ["/maps", "/data"]
EXPOSE 8080
HEALTHCHECK --interval=15s --timeout=5s --start-period=30s --retries=3 \
    CMD ["python", "-c", "import os, urllib.request as u; u.urlopen(f\"http://127.0.0.1:{os.environ['RHOLOC_PORT']}/healthz\", timeout=4)"]
ENTRYPOINT ["rholoc"]
CMD ["serve"]

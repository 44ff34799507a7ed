# One image that serves (the default) or solves: `docker run ... wrenchbook work --data /data`.
# python:3.12-slim of August 2026; `docker buildx imagetools inspect python:3.12-slim` prints the newest digest.
FROM python:3.12-slim@sha256:78387bc3881b8273120a12ebe6c1ab22b018ccc2c9adf565ae1ac9b536e184ea AS base

FROM base AS build
WORKDIR /src
# Compiles the kernel; this stage is not in the image.
RUN apt-get update && apt-get install -y --no-install-recommends gcc libc6-dev
# The server, and with the extra `cluster` a scheduler or worker of Dask (compose.yaml).
COPY requirements.lock requirements-cluster.lock ./
RUN python -m venv /opt/wrenchbook \
    && /opt/wrenchbook/bin/pip install --no-cache-dir --require-hashes \
        -r requirements.lock -r requirements-cluster.lock
COPY pyproject.toml hatch_build.py README.md LICENSE ./
COPY src src
COPY fea fea
COPY surrogate surrogate
COPY service service
COPY data/components data/components
RUN /opt/wrenchbook/bin/pip install --no-cache-dir --no-deps --no-build-isolation .

FROM base
RUN useradd --create-home --uid 10001 wrenchbook && install -d -m 0700 -o wrenchbook /data
COPY --from=build /opt/wrenchbook /opt/wrenchbook
ENV PATH=/opt/wrenchbook/bin:$PATH PYTHONUNBUFFERED=1 WRENCHBOOK_DATA=/data
USER wrenchbook
WORKDIR /home/wrenchbook
VOLUME /data
EXPOSE 8000
# Without a key the reply is 401, which shows that the server is up.
HEALTHCHECK --interval=10s --timeout=3s --start-period=30s CMD \
    ["python", "-c", "import http.client as h; c = h.HTTPConnection('127.0.0.1:8000', timeout=2); c.request('GET', '/health/ready'); exit(c.getresponse().status not in (200, 401))"]
ENTRYPOINT ["wrenchbook"]
# A server on a network needs keys: the first one is made and printed once (docker logs).
CMD ["serve", "--host", "0.0.0.0", "--first-key"]

# One image that can serve (the default) or work: `docker run ... wrenchbook work --data /data`.
FROM python:3.12-slim AS build
WORKDIR /src
# Compiles the kernel; this stage is not in the image.
RUN apt-get update && apt-get install -y --no-install-recommends gcc libc6-dev
COPY requirements.lock ./
RUN python -m venv /opt/wrenchbook \
    && /opt/wrenchbook/bin/pip install --no-cache-dir --require-hashes -r requirements.lock
COPY pyproject.toml hatch_build.py README.md LICENSE wrenchbook.py ./
COPY fea fea
COPY surrogate surrogate
COPY service service
COPY data/components data/components
RUN /opt/wrenchbook/bin/pip install --no-cache-dir --no-deps --no-build-isolation .
# EXTRAS=cluster for a server, scheduler or worker of a Dask cluster (compose.yaml).
ARG EXTRAS=""
RUN test -z "$EXTRAS" || /opt/wrenchbook/bin/pip install --no-cache-dir --no-build-isolation ".[$EXTRAS]"

FROM python:3.12-slim
RUN useradd --create-home --uid 10001 wrenchbook && install -d -o wrenchbook /data
COPY --from=build /opt/wrenchbook /opt/wrenchbook
ENV PATH=/opt/wrenchbook/bin:$PATH PYTHONUNBUFFERED=1 WRENCHBOOK_DATA=/data
USER wrenchbook
WORKDIR /home/wrenchbook
VOLUME /data
EXPOSE 8000
# Without a key it is told no more than that it answers.
HEALTHCHECK --interval=10s --timeout=3s --start-period=30s CMD \
    python -c "import http.client as h; c = h.HTTPConnection('127.0.0.1:8000', timeout=2); c.request('GET', '/health/ready'); exit(c.getresponse().status not in (200, 401))"
ENTRYPOINT ["wrenchbook"]
# Others reach it, so it needs keys: the first is made and printed, once (docker logs).
CMD ["serve", "--host", "0.0.0.0", "--first-key"]

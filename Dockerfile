# The service in a container: run `docker compose up`; `docker compose logs` shows the login link.
FROM python:3.12-slim AS build
WORKDIR /source
COPY . .
RUN python -m pip wheel --no-cache-dir --no-deps --wheel-dir /wheels .

FROM python:3.12-slim
LABEL org.opencontainers.image.title="Unghost" \
      org.opencontainers.image.licenses="Apache-2.0"
# For PostgreSQL, S3 and a cluster of workers, build with --build-arg LOCK=requirements-cluster.lock.
ARG LOCK=requirements.lock
COPY requirements*.lock /locks/
COPY --from=build /wheels /wheels
RUN python -m pip install --no-cache-dir --require-hashes --requirement "/locks/$LOCK" \
    && python -m pip install --no-cache-dir --no-deps /wheels/*.whl && rm -r /locks /wheels \
    && useradd --system --uid 10001 --home-dir /data unghost \
    && install --directory --owner unghost --mode 700 /data
USER unghost
WORKDIR /data
ENV UNGHOST_DATA=/data \
    UNGHOST_HOST=0.0.0.0 \
    UNGHOST_PORT=8000 \
    XDG_STATE_HOME=/data/state \
    PYTHONDONTWRITEBYTECODE=1 \
    PYTHONUNBUFFERED=1
VOLUME /data
EXPOSE 8000
HEALTHCHECK --interval=10s --timeout=5s --start-period=30s --retries=3 \
    CMD ["python", "-I", "-c", "import urllib.request as web; web.build_opener(web.ProxyHandler({})).open('http://127.0.0.1:8000/readyz', timeout=4)"]
STOPSIGNAL SIGTERM
CMD ["unghost", "serve"]

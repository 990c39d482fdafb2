"""A place for jobs."""

from job_site import busy_site as busy_site
from job_site import site as site

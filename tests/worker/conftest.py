"""Places for jobs, with workers on one machine and on several."""

from job_site import busy_site as busy_site
from job_site import campus as campus
from job_site import site as site
from shared_stores import open_storage as open_storage
from shared_stores import storage_url as storage_url

"""The client for asyncio, of which ``client/write_sync.py`` makes the blocking one."""

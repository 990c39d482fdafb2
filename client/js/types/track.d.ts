// Written by client/js/write_types.py: run `make format`.
/** What {@link Client.track} gives. */
export class TrackStream {
    /** Begin a track; `errorOf` makes the error of what the service said, or of nothing. */
    static open(address: any, key: any, begin: any, onTracked: any, errorOf: any, signal: any): Promise<TrackStream>;
    constructor(socket: any, onTracked: any, errorOf: any);
    /**
     * Send a frame; resolves once the service has taken it in. One at a time.
     * @param {number} time_s when it was taken, on any one clock
     * @throws {RholocError} what the service objects to, or that the connection broke off
     */
    frame(time_s: number, picture: Blob | BufferSource): Promise<any>;
    close(): void;
    #private;
}

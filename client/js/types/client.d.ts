// Written by client/js/write_types.py: run `make format`.
/** What the service answered instead of what was asked for; the code is "unreachable" where there was no answer. */
export class RholocError extends Error {
    constructor({ code, message, hint, request_id }: {
        code: any;
        message: any;
        hint?: string;
        request_id?: string;
    }, status?: number);
    code: any;
    hint: string;
    status: number;
    requestId: string;
    /** Whether the same request may succeed later. */
    get passes(): boolean;
}
/**
 * A rholoc service.
 *
 *     const rholoc = new Client("https://rholoc.example", { key });
 *     const answer = await rholoc.localize("hall", jpeg, { camera: { fx: 1510, fy: 1510, cx: 960, cy: 540 } });
 *     if (answer.localized) console.log(answer.pose.position, answer.recognized);
 */
export class Client {
    /**
     * @param {string | URL} address of the service
     * @param {{key?: string, fetch?: typeof fetch}} options the API key, where the service asks for one
     */
    constructor(address: string | URL, { key, fetch }?: {
        key?: string;
        fetch?: typeof globalThis.fetch;
    });
    _base: URL;
    _headers: {
        Authorization: string;
    } | {
        Authorization?: undefined;
    };
    _fetch: typeof fetch;
    /**
     * Where a picture was taken. "No pose" is an answer, with a reason, not an error.
     * @param {string | string[]} map a map's name; several, or "all", to find it in any of them
     * @param {Blob | BufferSource} image JPEG, PNG or WebP
     * @param {import("./api.d.ts").LocalizeOptions} options
     * @param {{signal?: AbortSignal}} how
     * @returns {Promise<import("./api.d.ts").LocalizationOut>}
     */
    localize(map: string | string[], image: Blob | BufferSource, options?: import("./api.d.ts").LocalizeOptions, { signal }?: {
        signal?: AbortSignal;
    }): Promise<import("./api.d.ts").LocalizationOut>;
    /**
     * All maps.
     * @returns {Promise<import("./api.d.ts").MapSummary[]>}
     */
    maps(): Promise<import("./api.d.ts").MapSummary[]>;
    /**
     * One map, with its named points and areas.
     * @param {string} name
     * @returns {Promise<import("./api.d.ts").MapDetail>}
     */
    map(name: string): Promise<import("./api.d.ts").MapDetail>;
    /**
     * A job: its status, and how far it is.
     * @param {string} id
     * @returns {Promise<import("./api.d.ts").JobOut>}
     */
    job(id: string): Promise<import("./api.d.ts").JobOut>;
    /**
     * Send a recording, in pieces that go on where they broke off; resolves to the id of the job that makes a map of it.
     * @param {Blob} recording a video, or a zip archive of a recording's files
     * @param {{map: string, name?: string, onProgress?: (sent: number, total: number) => void, signal?: AbortSignal}} options
     */
    upload(recording: Blob, { map, name, onProgress, signal }: {
        map: string;
        name?: string;
        onProgress?: (sent: number, total: number) => void;
        signal?: AbortSignal;
    }): Promise<any>;
    _stand(location: any, signal: any): Promise<{
        offset: number;
        job: any;
    }>;
    _send(location: any, recording: any, offset: any, signal: any): Promise<{
        offset: number;
        job: any;
    }>;
    _json(method: any, where: any, options?: {}): Promise<any>;
    /**
     * @param {string} method
     * @param {string} where
     * @param {RequestInit} options
     * @throws {RholocError} for every answer but success, and where there is none
     */
    _request(method: string, where: string, { headers, ...options }?: RequestInit): Promise<Response>;
}

// Written by client/js/write_types.py: run `make format`.
/** A path with its parts escaped: path`v1/maps/${name}`. */
export function path(texts: any, ...values: any[]): any;
/** What the service answered instead of what was asked for; the code is "unreachable" where there was no answer. */
export class RholocError extends Error {
    constructor({ code, message, hint, request_id }: {
        code: any;
        message: any;
        hint?: string;
        request_id?: string;
    }, status?: number, cause?: any);
    code: any;
    summary: any;
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
     * @param {string | (() => string | null)} [options.key] the API key, where the service asks for one, or what gives it
     * @param {(text: string) => string} [options.translate] messages and hints of errors into another language
     * @param {(error: RholocError) => Promise<boolean>} [options.onRefused] called where the key is missing or does not suffice;
     *   gives whether there is another one, with which the request is made again
     */
    constructor(address: string | URL, { key, fetch, translate, onRefused }?: {
        key?: string | (() => string | null);
        fetch?: typeof globalThis.fetch;
        translate?: (text: string) => string;
        onRefused?: (error: RholocError) => Promise<boolean>;
    });
    /**
     * Where a picture was taken. "No pose" is an answer, with a reason, not an error.
     * @param {string | string[]} map a map's name; several, or "all", to find it in any of them
     * @param {Blob | BufferSource} image JPEG, PNG or WebP
     */
    localize(map: string | string[], image: Blob | BufferSource, options?: import("./api.d.ts").LocalizeOptions, { signal }?: {
        signal?: AbortSignal;
    }): Promise<import("./api.d.ts").LocalizationOut>;
    /**
     * Follow a camera in a map; resolves once the service is ready for frames.
     * @param {{camera?: object, dof?: string | number}} begin what holds for all frames
     * @param {(tracked: any) => void} onTracked hears what is known of the camera whenever that changes
     * @param {{signal?: AbortSignal}} how the signal ends it
     * @throws {RholocError} what the service objects to, or `unreachable`, also if the signal ends it while it connects
     */
    track(map: string, begin: {
        camera?: object;
        dof?: string | number;
    }, onTracked: (tracked: any) => void, { signal }?: {
        signal?: AbortSignal;
    }): Promise<TrackStream>;
    /** All maps. */
    maps(): Promise<import("./api.d.ts").MapSummary[]>;
    /** One map, with its named points and areas. */
    map(name: string): Promise<import("./api.d.ts").MapDetail>;
    /** A job: its status, and how far it is. */
    job(id: string): Promise<import("./api.d.ts").JobOut>;
    /**
     * Follow a job until it ends, through breaks of the connection; resolves to the job as it ended.
     * @param {(error: RholocError) => void} [options.onLost] there is no connection; it is waited for
     */
    waitForJob(id: string, { onChange, onLost, signal }?: {
        onChange?: (job: import("./api.d.ts").JobOut) => void;
        onLost?: (error: RholocError) => void;
        signal?: AbortSignal;
    }): Promise<import("./api.d.ts").JobOut>;
    /**
     * Send a recording, in pieces that go on where they broke off; resolves to the id of the job that makes a map of it.
     * @param {Blob} recording a video, or a zip archive of a recording's files
     * @param {string} [options.name] of the file
     * @param {string} [options.kind] "build" a map (the default), or "update" the one there is
     * @param {string} [options.camera] one that the service knows, by name
     * @param {string | null} [options.location] where an earlier try stands
     * @param {number} [options.tries] failures in a row after which to give up
     * @param {(location: string | null) => void} [options.onLocation] where to go on after a reload; null where it is gone
     * @param {(error: RholocError) => void} [options.onWaiting] it failed, and is tried again
     */
    upload(recording: Blob, { location, tries, onProgress, onLocation, onWaiting, signal, name, ...metadata }: {
        map: string;
        name?: string;
        kind?: string;
        camera?: string;
        location?: string | null;
        tries?: number;
        onProgress?: (sent: number, total: number) => void;
        onLocation?: (location: string | null) => void;
        onWaiting?: (error: RholocError) => void;
        signal?: AbortSignal;
    }): Promise<string>;
    /** What a stream of events holds, as JSON, until it ends: `v1/jobs/ID/events`, `v1/maps/NAME/live`. */
    events(where: string, { signal }?: {
        signal?: AbortSignal;
    }): AsyncGenerator<any>;
    /** What a GET of any route answers, as {@link call} does. */
    get(where: any, options?: {}): Promise<any>;
    /** What a GET of a route answers that is no JSON: a map's scene or room, a file. */
    bytes(where: any, options?: {}): Promise<ArrayBuffer>;
    /**
     * What any route answers, as JSON; null where it answers nothing.
     * @param {string} where the path, such as path`v1/sites/${name}`
     */
    call(method: string, where: string, options?: {
        query?: object;
        body?: any;
        headers?: Record<string, string>;
        signal?: AbortSignal;
    }): Promise<any>;
    /**
     * The response of any route.
     * @param {{query?: object, body?: any, headers?: Record<string, string>, signal?: AbortSignal}} options a body is sent as JSON
     *   unless it is a Blob, FormData or bytes
     * @throws {RholocError} for every answer but success, and where there is none
     */
    request(method: string, where: string, { query, body, headers, signal }?: {
        query?: object;
        body?: any;
        headers?: Record<string, string>;
        signal?: AbortSignal;
    }): Promise<Response>;
    /** The headers that prove who asks; none without a key. */
    get authorization(): {
        Authorization: string;
    } | {
        Authorization?: undefined;
    };
    /** The address of a path; what is empty in the query is left out. */
    url(where: any, query?: {}): URL;
    #private;
}
import { TrackStream } from "./track.js";

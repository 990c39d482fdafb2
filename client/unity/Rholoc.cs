// The client of rholoc for Unity and .NET, one file without dependencies: pictures in, poses out, and the place of an AR
// session in a map.
//
//     var rholoc = new Rholoc.Client("https://rholoc.example", key);
//     var session = new Rholoc.MapSession((jpeg, camera) => rholoc.LocalizeAsync("hall", jpeg, camera));
//     // for every frame, with the camera's pose when the picture was taken:
//     var p = camera.transform.position; var q = camera.transform.rotation;
//     var ignored = session.Offer(new[] {p.x, p.y, p.z}.Select(v => (double)v).ToArray(),
//         new double[] {q.x, q.y, q.z, q.w}, jpeg, intrinsics, Time.realtimeSinceStartup);
//     var at = session.ToSession(new[] {4.2, 1.0, 0.8});      // a point of the map, or null while the place is not known
//     if (at != null) marker.position = new Vector3((float)at[0], (float)at[1], (float)at[2]);
//
// Maps are right-handed with z up, in metres; their cameras look along z, with x right and y down. Unity is left-handed with y
// up; its cameras look along z, with x right and y up. Transforms are four rows of four numbers, one after the other,
// named T_to_from.

using System;
using System.Collections.Generic;
using System.Globalization;
using System.IO;
using System.Linq;
using System.Net;
using System.Text;
using System.Threading.Tasks;

namespace Rholoc
{
    /// <summary>Intrinsics of a picture in pixels; pixel (0, 0) is the centre of the top-left one.</summary>
    public sealed class Intrinsics
    {
        public int Width, Height;
        public double Fx, Fy, Cx, Cy;

        /// <summary>Of a picture whose first row is at the top, by Unity's projection matrix: its entries 00, 11, 02 and 12.</summary>
        public static Intrinsics OfProjection(double m00, double m11, double m02, double m12, int width, int height)
        {
            return new Intrinsics
            {
                Width = width, Height = height, Fx = m00 * width / 2, Fy = m11 * height / 2,
                Cx = (1 - m02) * width / 2 - 0.5, Cy = (1 + m12) * height / 2 - 0.5,
            };
        }
    }

    /// <summary>What the service says about a picture. "No pose" is an answer, with a reason.</summary>
    public sealed class Answer
    {
        public bool Localized;
        public string Reason = "", Hint = "", Map = "";

        /// <summary>Probability 0 to 1 of the right place, and of a pose within 10 cm and 5°.</summary>
        public double Recognized, Confidence;

        /// <summary>T_map_camera by the map's axes; null without a pose.</summary>
        public double[] T_map_camera;

        /// <summary>Largest standard deviation of the position [m] and of the rotation [rad] about an axis.</summary>
        public double SigmaM, SigmaRad;

        /// <summary>Named areas that the camera is in, and named points within 2 m.</summary>
        public string[] Areas = {}, Near = {};

        /// <summary>The camera in Unity's axes, where the map's y is Unity's z: x, y, z, and the quaternion x, y, z, w.</summary>
        public double[] UnityPosition { get { return T_map_camera == null ? null : Axes.PointToUnity(Transform.Translation(T_map_camera)); } }
        public double[] UnityRotation { get { return T_map_camera == null ? null : Transform.Quaternion(Axes.CameraToUnity(T_map_camera)); } }

        internal static Answer Of(object json)
        {
            var answer = (Dictionary<string, object>)json;
            var found = new Answer
            {
                Localized = (bool)answer["localized"], Map = (string)answer["map"],
                Recognized = (double)answer["recognized"], Confidence = (double)answer["confidence"],
                Areas = Words(answer["areas"]), Near = Words(answer["near"]),
            };
            var diagnosis = answer["diagnosis"] as Dictionary<string, object>;
            if (diagnosis != null) { found.Reason = (string)diagnosis["message"]; found.Hint = (string)diagnosis["hint"]; }
            if (answer["pose"] == null) return found;
            found.T_map_camera = Rows(((Dictionary<string, object>)answer["pose"])["T_map_camera"]);
            var covariance = answer["covariance"] == null ? null : Rows(answer["covariance"]);
            found.SigmaM = covariance == null ? double.PositiveInfinity : Sigma(covariance, 0);
            found.SigmaRad = covariance == null ? double.PositiveInfinity : Sigma(covariance, 3) * Math.PI / 180;
            return found;
        }

        static double Sigma(double[] covariance, int first)
        {
            return Math.Sqrt(Enumerable.Range(first, 3).Max(i => covariance[7 * i]));
        }

        static string[] Words(object list) { return ((List<object>)list).Cast<string>().ToArray(); }

        static double[] Rows(object rows)
        {
            return ((List<object>)rows).SelectMany(row => ((List<object>)row).Cast<double>()).ToArray();
        }
    }

    /// <summary>What the service answered instead; the code is "unreachable" where there was no answer.</summary>
    public sealed class RholocException : Exception
    {
        public readonly string Code, Hint;
        public readonly int Status;

        public RholocException(string code, string message, string hint, int status) : base(message)
        {
            Code = code;
            Hint = hint;
            Status = status;
        }
    }

    /// <summary>A rholoc service.</summary>
    public sealed class Client
    {
        readonly string address, key;

        public Client(string address, string key = "")
        {
            this.address = address.TrimEnd('/');
            this.key = key;
        }

        public int TimeoutMs = 10000;

        /// <summary>Where a picture (JPEG or PNG) was taken; in a thread of its own.</summary>
        public Task<Answer> LocalizeAsync(string map, byte[] picture, Intrinsics camera)
        {
            return Task.Run(() => Localize(map, picture, camera));
        }

        /// <summary>Where a picture was taken; blocks. Throws RholocException.</summary>
        public Answer Localize(string map, byte[] picture, Intrinsics camera)
        {
            var query = string.Format(
                CultureInfo.InvariantCulture, "fx={0:R}&fy={1:R}&cx={2:R}&cy={3:R}", camera.Fx, camera.Fy, camera.Cx, camera.Cy);
            var where = address + "/v1/maps/" + Uri.EscapeDataString(map) + "/localize?" + query;
            var request = (HttpWebRequest)WebRequest.Create(where);
            request.Method = "POST";
            request.ContentType = picture.Length > 0 && picture[0] == 0x89 ? "image/png" : "image/jpeg";
            request.Timeout = request.ReadWriteTimeout = TimeoutMs;
            if (key != "") request.Headers["Authorization"] = "Bearer " + key;
            try
            {
                using (var body = request.GetRequestStream()) body.Write(picture, 0, picture.Length);
                using (var response = request.GetResponse()) return Answer.Of(Json.Parse(Text(response)));
            }
            catch (WebException error)
            {
                if (error.Response == null) throw new RholocException("unreachable", address + " does not answer.", "", 0);
                using (error.Response) throw Refusal((HttpWebResponse)error.Response);
            }
        }

        static RholocException Refusal(HttpWebResponse response)
        {
            var status = (int)response.StatusCode;
            try
            {
                var body = (Dictionary<string, object>)Json.Parse(Text(response));
                return new RholocException((string)body["code"], (string)body["message"], (string)body["hint"], status);
            }
            catch (Exception error) when (error is FormatException || error is InvalidCastException || error is KeyNotFoundException)
            {
                return new RholocException("error", "The service answered with status " + status + ".", "", status);
            }
        }

        static string Text(WebResponse response)
        {
            using (var reader = new StreamReader(response.GetResponseStream(), Encoding.UTF8)) return reader.ReadToEnd();
        }
    }

    /// <summary>
    /// Where an AR session lies in a map: a robust mean over answers, as MapSession of @rholoc/client. Not safe to share between
    /// threads: call it from Unity's own, to which its awaits return.
    /// </summary>
    public sealed class MapSession
    {
        const int Kept = 12; // samples
        const double DriftM = 0.05, DriftRad = 0.04; // by which a session may have drifted between two samples that agree
        const double DriftShare = 0.02; // of the way from where a sample was taken
        const double Sigmas = 3;
        const int Contradictions = 3; // in a row, after which a place is given up

        struct Sample
        {
            public double[] T, At;
            public double SigmaM, SigmaRad, Recognized;
        }

        readonly Func<byte[], Intrinsics, Task<Answer>> locate;
        List<Sample> samples = new List<Sample>();
        bool asking;
        double askedS = double.NegativeInfinity, agreedS = double.NegativeInfinity;
        int contradicted;

        public MapSession(Func<byte[], Intrinsics, Task<Answer>> locate) { this.locate = locate; }

        /// <summary>Probability of the right place from which one answer is enough; below, two that agree.</summary>
        public double MinRecognized = 0.8;

        /// <summary>Seconds between questions once the place is known; a third of it before.</summary>
        public double IntervalS = 1.5;

        /// <summary>Seconds without an answer that agrees, after which the place is lost.</summary>
        public double LostAfterS = 20;

        public Action OnLocalized = () => { }, OnLost = () => { };
        public Action<Exception> OnError = error => { };

        /// <summary>The session's place, right-handed; null while it is not known.</summary>
        public double[] T_map_session { get; private set; }

        /// <summary>
        /// Offer a frame: the camera's pose in Unity's axes (x, y, z and the quaternion x, y, z, w) when the picture was taken, the
        /// picture, its intrinsics, and the time in seconds. Completes once it is answered, with whether it was asked about.
        /// </summary>
        public async Task<bool> Offer(double[] position, double[] rotation, byte[] picture, Intrinsics camera, double nowS)
        {
            var T_session_camera = Axes.CameraFromUnity(position, rotation);
            Lapse(nowS);
            if (asking || nowS - askedS < (T_map_session == null ? IntervalS / 3 : IntervalS)) return false;
            asking = true;
            askedS = nowS;
            try
            {
                var answer = await locate(picture, camera);
                if (answer.Localized && !double.IsInfinity(answer.SigmaM)) Take(answer, T_session_camera, nowS);
            }
            catch (RholocException error) { OnError(error); }
            finally { asking = false; }
            return true;
        }

        /// <summary>T_map_camera of a pose of the session in Unity's axes; null while the place is not known.</summary>
        public double[] InMap(double[] position, double[] rotation)
        {
            return T_map_session == null ? null : Transform.Multiply(T_map_session, Axes.CameraFromUnity(position, rotation));
        }

        /// <summary>A point of the map in the session's Unity axes; null while the place is not known.</summary>
        public double[] ToSession(double[] point)
        {
            if (T_map_session == null) return null;
            var at = Transform.Apply(Transform.Inverse(T_map_session), point);
            return new[] { at[0], at[1], -at[2] };
        }

        void Take(Answer answer, double[] T_session_camera, double nowS)
        {
            var sample = new Sample
            {
                T = Transform.Multiply(answer.T_map_camera, Transform.Inverse(T_session_camera)),
                At = Transform.Translation(T_session_camera),
                SigmaM = Math.Max(0.005, answer.SigmaM), SigmaRad = Math.Max(0.003, answer.SigmaRad),
                Recognized = answer.Recognized,
            };
            samples.Add(sample);
            if (samples.Count > Kept) samples.RemoveAt(0);
            var group = samples.Where(one => Agree(one, sample)).ToList();
            var present = sample;
            present.T = T_map_session;
            var expected = T_map_session == null || Agree(present, sample);
            if (!expected && ++contradicted < Contradictions) return;
            if (group.Count < 2 && sample.Recognized < MinRecognized) return;
            if (!expected) samples = group;
            contradicted = 0;
            agreedS = nowS;
            T_map_session = Mean(group, sample.At);
            OnLocalized();
        }

        void Lapse(double nowS)
        {
            if (T_map_session == null || nowS - agreedS <= LostAfterS) return;
            T_map_session = null;
            samples.Clear();
            OnLost();
        }

        /// <summary>Whether two samples place the second one's camera alike.</summary>
        static bool Agree(Sample a, Sample b)
        {
            var there = Transform.Apply(a.T, b.At);
            var here = Transform.Apply(b.T, b.At);
            var apart = Math.Sqrt(there.Zip(here, (u, v) => (u - v) * (u - v)).Sum());
            var sigmaM = Math.Sqrt(a.SigmaM * a.SigmaM + b.SigmaM * b.SigmaM);
            var sigmaRad = Math.Sqrt(a.SigmaRad * a.SigmaRad + b.SigmaRad * b.SigmaRad);
            return apart < DriftM + Sigmas * sigmaM && Transform.Angle(a.T, b.T) < DriftRad + Sigmas * sigmaRad;
        }

        /// <summary>The mean of samples, most exact around a point of the session; the nearer one was taken, the more it counts.</summary>
        static double[] Mean(List<Sample> samples, double[] at)
        {
            Func<Sample, double> precision = one =>
                1 / (one.SigmaM * one.SigmaM + DriftShare * DriftShare * one.At.Zip(at, (u, v) => (u - v) * (u - v)).Sum());
            var total = samples.Sum(precision);
            var q = new double[4];
            var first = Transform.Quaternion(samples[0].T);
            foreach (var one in samples)
            {
                var own = Transform.Quaternion(one.T);
                var sign = own.Zip(first, (u, v) => u * v).Sum() < 0 ? -1 : 1;
                for (var i = 0; i < 4; i++) q[i] += sign * Math.Pow(one.SigmaRad, -2) * own[i];
            }
            var there = new double[3];
            foreach (var one in samples)
            {
                var own = Transform.Apply(one.T, at);
                for (var i = 0; i < 3; i++) there[i] += precision(one) / total * own[i];
            }
            var R = Transform.Of(new double[3], q);
            var turned = Transform.Apply(R, at);
            return Transform.Of(new[] { there[0] - turned[0], there[1] - turned[1], there[2] - turned[2] }, q);
        }
    }

    /// <summary>Poses between Unity's axes and the service's.</summary>
    public static class Axes
    {
        /// <summary>A point of a map in Unity's axes: the map's z is up, its y Unity's z.</summary>
        public static double[] PointToUnity(double[] point) { return new[] { point[0], point[2], point[1] }; }

        /// <summary>A camera's pose in a map (T_map_camera) in Unity's axes.</summary>
        public static double[] CameraToUnity(double[] T_map_camera)
        {
            var rows = new[] { 0, 2, 1 };
            var T = Transform.Of(new double[3], new double[] { 0, 0, 0, 1 });
            for (var i = 0; i < 3; i++)
                for (var j = 0; j < 4; j++)
                    T[4 * i + j] = (j == 1 ? -1 : 1) * T_map_camera[4 * rows[i] + j];
            return T;
        }

        /// <summary>
        /// A camera of Unity (x, y, z and the quaternion x, y, z, w) in the right-handed frame whose z axis is turned round, by the
        /// service's camera axes.
        /// </summary>
        public static double[] CameraFromUnity(double[] position, double[] rotation)
        {
            var T = Transform.Of(position, rotation);
            for (var i = 0; i < 3; i++)
                for (var j = 0; j < 4; j++)
                    T[4 * i + j] *= ((i == 2) != (j == 2) ? -1 : 1) * (j == 1 || j == 2 ? -1 : 1);
            return T;
        }
    }

    /// <summary>Rigid transforms: sixteen numbers, row by row.</summary>
    public static class Transform
    {
        public static double[] Of(double[] position, double[] quaternion)
        {
            var length = Math.Sqrt(quaternion.Sum(value => value * value));
            double x = quaternion[0] / length, y = quaternion[1] / length, z = quaternion[2] / length, w = quaternion[3] / length;
            return new[]
            {
                1 - 2 * (y * y + z * z), 2 * (x * y - z * w), 2 * (x * z + y * w), position[0],
                2 * (x * y + z * w), 1 - 2 * (x * x + z * z), 2 * (y * z - x * w), position[1],
                2 * (x * z - y * w), 2 * (y * z + x * w), 1 - 2 * (x * x + y * y), position[2],
                0, 0, 0, 1,
            };
        }

        public static double[] Multiply(double[] A, double[] B)
        {
            var C = new double[16];
            for (var i = 0; i < 4; i++)
                for (var j = 0; j < 4; j++)
                    for (var k = 0; k < 4; k++) C[4 * i + j] += A[4 * i + k] * B[4 * k + j];
            return C;
        }

        public static double[] Inverse(double[] T)
        {
            var back = new double[16];
            for (var i = 0; i < 3; i++)
                for (var j = 0; j < 3; j++)
                {
                    back[4 * i + j] = T[4 * j + i];
                    back[4 * i + 3] -= T[4 * j + i] * T[4 * j + 3];
                }
            back[15] = 1;
            return back;
        }

        public static double[] Apply(double[] T, double[] point)
        {
            return new[] { 0, 4, 8 }.Select(i => T[i] * point[0] + T[i + 1] * point[1] + T[i + 2] * point[2] + T[i + 3]).ToArray();
        }

        public static double[] Translation(double[] T) { return new[] { T[3], T[7], T[11] }; }

        /// <summary>Angle between two rotations [rad].</summary>
        public static double Angle(double[] A, double[] B)
        {
            var trace = new[] { 0, 1, 2, 4, 5, 6, 8, 9, 10 }.Sum(i => A[i] * B[i]);
            return Math.Acos(Math.Min(1, Math.Max(-1, (trace - 1) / 2)));
        }

        /// <summary>Quaternion x, y, z, w: of four ways to compute it, that with the largest divisor.</summary>
        public static double[] Quaternion(double[] T)
        {
            double a = T[9] - T[6], b = T[2] - T[8], c = T[4] - T[1], d = T[1] + T[4], e = T[2] + T[8], f = T[6] + T[9];
            var squares = new[]
            {
                1 + T[0] - T[5] - T[10], 1 - T[0] + T[5] - T[10], 1 - T[0] - T[5] + T[10], 1 + T[0] + T[5] + T[10],
            };
            var k = Array.IndexOf(squares, squares.Max());
            var parts = new[]
            {
                new[] { squares[0], d, e, a }, new[] { d, squares[1], f, b },
                new[] { e, f, squares[2], c }, new[] { a, b, c, squares[3] },
            }[k];
            return parts.Select(value => value / (2 * Math.Sqrt(squares[k]))).ToArray();
        }
    }

    /// <summary>JSON as Dictionary, List, string, double, bool and null. Throws FormatException.</summary>
    public static class Json
    {
        const int MaxDepth = 64;

        public static object Parse(string text)
        {
            var at = 0;
            var value = Value(text, ref at, 0);
            Skip(text, ref at);
            if (at != text.Length) throw new FormatException("More than one JSON value.");
            return value;
        }

        static object Value(string text, ref int at, int depth)
        {
            if (depth > MaxDepth) throw new FormatException("Nested too deep.");
            switch (Next(text, ref at))
            {
                case '{':
                    var members = new Dictionary<string, object>();
                    for (at++; Next(text, ref at) != '}'; Separate(text, ref at, '}'))
                    {
                        var name = Word(text, ref at);
                        Expect(text, ref at, ":");
                        members[name] = Value(text, ref at, depth + 1);
                    }
                    at++;
                    return members;
                case '[':
                    var list = new List<object>();
                    for (at++; Next(text, ref at) != ']'; Separate(text, ref at, ']')) list.Add(Value(text, ref at, depth + 1));
                    at++;
                    return list;
                case '"': return Word(text, ref at);
                case 't': Expect(text, ref at, "true"); return true;
                case 'f': Expect(text, ref at, "false"); return false;
                case 'n': Expect(text, ref at, "null"); return null;
                default:
                    var begin = at;
                    while (at < text.Length && "+-.eE0123456789".IndexOf(text[at]) >= 0) at++;
                    return double.Parse(text.Substring(begin, at - begin), NumberStyles.Float, CultureInfo.InvariantCulture);
            }
        }

        static string Word(string text, ref int at)
        {
            Expect(text, ref at, "\"");
            var word = new StringBuilder();
            for (; at < text.Length && text[at] != '"'; at++)
            {
                if (text[at] != '\\') { word.Append(text[at]); continue; }
                if (++at >= text.Length) break;
                var escape = "\"\\/bfnrt".IndexOf(text[at]);
                if (escape >= 0) { word.Append("\"\\/\b\f\n\r\t"[escape]); continue; }
                if (text[at] != 'u') throw new FormatException("An unknown escape.");
                if (at + 4 >= text.Length) break;
                word.Append((char)int.Parse(text.Substring(at + 1, 4), NumberStyles.AllowHexSpecifier, CultureInfo.InvariantCulture));
                at += 4;
            }
            Expect(text, ref at, "\"");
            return word.ToString();
        }

        static void Separate(string text, ref int at, char end)
        {
            if (Next(text, ref at) == ',') at++;
            else if (text[at] != end) throw new FormatException("A comma is missing.");
        }

        static void Expect(string text, ref int at, string word)
        {
            Skip(text, ref at);
            if (string.CompareOrdinal(text, at, word, 0, word.Length) != 0) throw new FormatException("Not JSON at " + at + ".");
            at += word.Length;
        }

        static char Next(string text, ref int at)
        {
            Skip(text, ref at);
            if (at >= text.Length) throw new FormatException("JSON ends too early.");
            return text[at];
        }

        static void Skip(string text, ref int at)
        {
            while (at < text.Length && char.IsWhiteSpace(text[at])) at++;
        }
    }
}

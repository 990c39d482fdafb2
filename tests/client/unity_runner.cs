// Runs parts of client/unity/Rholoc.cs for test_unity.py, on what a JSON file gives.

using System;
using System.Collections.Generic;
using System.IO;
using System.Linq;
using System.Threading.Tasks;
using Rholoc;

static class Runner
{
    static double[] Numbers(object list) { return ((List<object>)list).Cast<double>().ToArray(); }

    static string Text(double[] numbers)
    {
        return numbers == null ? "null" : "[" + string.Join(",", numbers.Select(one => one.ToString("R"))) + "]";
    }

    static int Main(string[] arguments)
    {
        var given = (Dictionary<string, object>)Json.Parse(File.ReadAllText(arguments[1]));
        if (arguments[0] == "poses")
            foreach (Dictionary<string, object> one in (List<object>)given["pairs"])
            {
                var answer = new Answer { T_map_camera = Numbers(one["T_map_camera"]) };
                Console.WriteLine("[{0},{1},{2}]", Text(answer.UnityPosition), Text(answer.UnityRotation),
                    Text(Axes.CameraFromUnity(Numbers(one["position"]), Numbers(one["rotation"]))));
            }
        if (arguments[0] == "session")
        {
            Answer next = null;
            var events = new List<string>();
            var session = new MapSession((picture, camera) => Task.FromResult(next));
            session.OnLocalized = () => events.Add("localized");
            session.OnLost = () => events.Add("lost");
            foreach (Dictionary<string, object> one in (List<object>)given["frames"])
            {
                next = new Answer
                {
                    Localized = (bool)one["localized"], Recognized = (double)one["recognized"],
                    T_map_camera = Numbers(one["T_map_camera"]), SigmaM = 0.01, SigmaRad = 0.3 * Math.PI / 180,
                };
                double[] position = Numbers(one["position"]), rotation = Numbers(one["rotation"]);
                session.Offer(position, rotation, null, null, (double)one["time_s"]).Wait();
                Console.WriteLine("[{0},{1}]", Text(session.InMap(position, rotation)), Text(session.ToSession(new double[] {1, 2, 3})));
            }
            Console.WriteLine("\"" + string.Join(" ", events) + "\"");
        }
        if (arguments[0] == "service")
        {
            var rholoc = new Rholoc.Client((string)given["url"]) { TimeoutMs = 60000 };
            var camera = new Intrinsics { Fx = (double)given["fx"], Fy = (double)given["fx"], Cx = (double)given["cx"], Cy = (double)given["cy"] };
            var picture = File.ReadAllBytes((string)given["picture"]);
            var answer = rholoc.LocalizeAsync("room", picture, camera).Result;
            Console.WriteLine(Text(answer.T_map_camera));
            Console.WriteLine(Text(new[] { answer.SigmaM, answer.SigmaRad, answer.Recognized, answer.Localized ? 1 : 0 }));
            try { rholoc.Localize("attic", picture, camera); }
            catch (RholocException error) { Console.WriteLine("\"" + error.Code + " " + error.Status + "\""); }
            try { new Rholoc.Client("http://127.0.0.1:9").Localize("attic", picture, camera); }
            catch (RholocException error) { Console.WriteLine("\"" + error.Code + "\""); }
        }
        return 0;
    }
}

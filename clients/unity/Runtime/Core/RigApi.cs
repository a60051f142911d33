using System;
using System.IO;
using System.Net;
using System.Text;
using Newtonsoft.Json;
using Newtonsoft.Json.Linq;

namespace MrNav
{
    /// <summary>The server refuses; <see cref="Code"/> is stable, the message is for the operator.</summary>
    public sealed class RefusedException : Exception
    {
        public readonly string Code;

        public RefusedException(string code, string message)
            : base(message)
        {
            Code = code;
        }
    }

    /// <summary>
    /// What is asked for, rather than streamed (docs/protocol.md, "REST"). Every call waits for the answer: call it
    /// from a task, never from the thread that draws.
    /// </summary>
    public sealed class RigApi
    {
        private const int TimeoutMs = 15000;

        private readonly string _url;
        private readonly string _token;
        private readonly Func<string> _session;

        /// <param name="url">The server's web address, for example "http://192.168.1.20:8000".</param>
        /// <param name="token">An operator's token.</param>
        /// <param name="session">Gives the session in control, as <see cref="HandLink.Session"/> does.</param>
        public RigApi(string url, string token, Func<string> session)
        {
            _url = url.TrimEnd('/');
            _token = token;
            _session = session;
        }

        /// <summary>Stop the manipulator at once; anybody may.</summary>
        public void Stop()
        {
            Ask("stop");
        }

        /// <summary>Ask for a mode: arm, disarm, manual, auto, hold, stop or reset.</summary>
        /// <param name="ask">The mode.</param>
        /// <param name="area">With "auto": the critical area to go to; null is the next one.</param>
        /// <exception cref="RefusedException">With the reason.</exception>
        public void Ask(string ask, string area = null)
        {
            var body = new JObject { { "ask", ask } };
            if (area != null)
            {
                body["area"] = area;
            }
            Post("/api/v1/mode", body);
        }

        /// <summary>The vessel model: its size, scale, and where critical areas are suggested.</summary>
        public JObject Vessel()
        {
            return (JObject)Send("GET", "/api/v1/vessel", null);
        }

        /// <summary>Mark a critical area; returns its id.</summary>
        /// <param name="centerVesselPx">Its centre in the vessel model's pixels.</param>
        /// <param name="epsilonUm">The robot has arrived within this distance of the centre.</param>
        /// <param name="label">A name for people.</param>
        /// <exception cref="RefusedException">If it lies outside the vessel, or elsewhere where it must not.</exception>
        public string MarkArea(Point3 centerVesselPx, double epsilonUm, string label = "")
        {
            var center = new JObject { { "frame", "vessel" }, { "x", centerVesselPx.X }, { "y", centerVesselPx.Y } };
            var body = new JObject { { "center", center }, { "epsilon_um", epsilonUm }, { "label", label } };
            return Post("/api/v1/critical-areas", body).Value<string>("id");
        }

        /// <summary>Begin a trial; returns its id.</summary>
        /// <param name="code">The operator's code in the study, never a name.</param>
        /// <param name="withAutonomy">The condition.</param>
        /// <param name="simulated">Whether a model stands in for the operator.</param>
        public string BeginTrial(string code, bool withAutonomy, bool simulated)
        {
            var body = new JObject
            {
                { "participant", code },
                { "condition", withAutonomy ? "with_autonomy" : "without_autonomy" },
                { "operator_kind", simulated ? "simulated" : "human" },
            };
            return Post("/api/v1/trials", body).Value<string>("id");
        }

        /// <summary>End a trial; returns its marks and metrics.</summary>
        public JObject EndTrial(string id)
        {
            return Post("/api/v1/trials/" + Uri.EscapeDataString(id) + "/end", new JObject());
        }

        private JObject Post(string path, JObject body)
        {
            return Send("POST", path, body) as JObject;
        }

        private JToken Send(string method, string path, JObject body)
        {
            var request = (HttpWebRequest)WebRequest.Create(_url + path);
            request.Method = method;
            request.Timeout = TimeoutMs;
            request.Proxy = null; // a proxy knows nothing of a server in the laboratory
            request.Headers["Authorization"] = "Bearer " + _token;
            string session = _session();
            if (session != null)
            {
                request.Headers["X-MRNAV-Session"] = session;
            }
            try
            {
                if (body != null)
                {
                    byte[] content = Encoding.UTF8.GetBytes(body.ToString(Formatting.None));
                    request.ContentType = "application/json";
                    using (Stream stream = request.GetRequestStream())
                    {
                        stream.Write(content, 0, content.Length);
                    }
                }
                using (WebResponse answer = request.GetResponse())
                {
                    return Parsed(answer);
                }
            }
            catch (WebException error)
            {
                if (error.Response == null)
                {
                    throw new RefusedException("no_answer", "no answer from " + _url + " (" + error.Message + ")");
                }
                using (error.Response)
                {
                    var problem = Parsed(error.Response) as JObject ?? new JObject();
                    throw new RefusedException(
                        problem.Value<string>("code") ?? "http",
                        problem.Value<string>("detail") ?? error.Message);
                }
            }
        }

        private static JToken Parsed(WebResponse answer)
        {
            using (var reader = new StreamReader(answer.GetResponseStream(), Encoding.UTF8))
            {
                string text = reader.ReadToEnd();
                try
                {
                    return text.Length == 0 ? null : JToken.Parse(text);
                }
                catch (JsonReaderException)
                {
                    return null; // a proxy's page, say; the status still tells
                }
            }
        }
    }
}

// Drives the core from the outside, for the tests: `frames`, `watch HOST PORT TOKEN`, `task HOST PORT URL TOKEN`.
using System;
using System.Collections.Generic;
using System.Globalization;
using System.Threading;
using MrNav;
using Newtonsoft.Json;
using Newtonsoft.Json.Linq;

public static class Program
{
    private const double PatienceS = 60.0;

    public static int Main(string[] words)
    {
        CultureInfo.DefaultThreadCurrentCulture = new CultureInfo("de-DE"); // a headset may write 0,5
        Thread.CurrentThread.CurrentCulture = CultureInfo.DefaultThreadCurrentCulture;
        switch (words[0])
        {
            case "frames":
                Say(FrameTable());
                return 0;
            case "watch":
                Watch(words[1], int.Parse(words[2]), words[3]);
                return 0;
            default:
                return Task(words[1], int.Parse(words[2]), words[3], words[4]);
        }
    }

    private static JObject FrameTable()
    {
        Point3 unity = Frames.UnityFromStage(new Point3(1000.0, 2000.0, 3000.0), 10.0);
        Point3 back = Frames.StageFromUnity(unity, 10.0);
        return new JObject { { "unity", Array(unity) }, { "back", Array(back) } };
    }

    /// <summary>Tell every notice, and every change of state, until standard input ends.</summary>
    private static void Watch(string host, int port, string token)
    {
        using (var link = new HandLink(host, port, token, "watcher", 60.0, "script"))
        using (var pump = new HandPump(link))
        {
            var ended = new ManualResetEvent(false);
            new Thread(() => { Console.In.ReadToEnd(); ended.Set(); }) { IsBackground = true }.Start();
            link.Start();
            var shown = LinkState.Ended;
            while (!ended.WaitOne(5))
            {
                pump.Give(new HandPose(new Point3(0.5, 1.25, double.NaN), true, true));
                if (link.State != shown)
                {
                    shown = link.State;
                    Say(new JObject { { "state", shown.ToString() } });
                }
                string notice;
                while (link.TryTakeNotice(out notice))
                {
                    Say(new JObject { { "notice", notice } });
                }
            }
        }
    }

    /// <summary>A semi-autonomous task: mark, arm, autonomy, hand-over, by hand, end.</summary>
    private static int Task(string host, int port, string url, string token)
    {
        var modes = new List<string>();
        using (var link = new HandLink(host, port, token, "Unity core", 60.0, "script"))
        using (var pump = new HandPump(link))
        {
            var api = new RigApi(url, token, () => link.Session);
            link.Start();
            var hand = new Hand(link, pump, modes);
            hand.Until("the rig sees the robot", t => t.Track == "tracking");
            JToken site = api.Vessel()["suggested_areas"][0];
            string area = api.MarkArea(new Point3(site.Value<double>("x_px"), site.Value<double>("y_px"), 0.0), 500.0);
            string trial = api.BeginTrial("SIM1", true, true);
            Insist(hand, () => api.Ask("arm"));
            do
            {
                // A busy machine that shows no picture for a while holds the rig: the operator asks again.
                Insist(hand, () => api.Ask("auto", area));
                hand.Until("autonomy", t => t.Mode == "AUTO");
                hand.Until("the hand-over", t => t.Mode == "MANUAL" || t.Mode == "HOLD");
            }
            while (link.Twin.Mode == "HOLD");
            Point3 handedOver = link.Twin.TipUm.Value;
            hand.Clutch = true;
            hand.Wait(0.3);
            for (int k = 0; k < 60; k++)
            {
                hand.PositionM += new Point3(0.0, 0.0, 0.0002); // away from the operator: stage -y
                hand.Wait(1.0 / 60.0);
            }
            Point3 moved = link.Twin.TipUm.Value - handedOver;
            double authority = link.Twin.Authority;
            hand.Clutch = false;
            hand.Wait(0.2);
            Insist(hand, () => api.Ask("disarm"));
            hand.Until("disarmed", t => t.Mode == "DISARMED");
            JObject result = api.EndTrial(trial);
            Say(new JObject
            {
                { "modes", new JArray(modes) },
                { "moved_um", Array(moved) },
                { "authority", authority },
                { "sent", pump.Sent },
                { "trial", result },
            });
        }
        return 0;
    }

    private static void Insist(Hand hand, Action ask)
    {
        double endS = HandLink.NowS + 20.0;
        while (true)
        {
            try
            {
                ask();
                return;
            }
            catch (RefusedException refused)
            {
                if (HandLink.NowS > endS)
                {
                    throw new TimeoutException(refused.Code + ": " + refused.Message);
                }
                hand.Wait(0.2);
            }
        }
    }

    private static JArray Array(Point3 p)
    {
        return new JArray(p.X, p.Y, p.Z);
    }

    private static void Say(JObject said)
    {
        Console.Out.WriteLine(said.ToString(Formatting.None));
        Console.Out.Flush();
    }

    /// <summary>A hand that is seen all the time, as 90 frames a second of a headset give it.</summary>
    private sealed class Hand
    {
        public Point3 PositionM = new Point3(0.1, 1.2, 0.4);
        public bool Clutch;
        private readonly HandLink _link;
        private readonly HandPump _pump;
        private readonly List<string> _modes;

        public Hand(HandLink link, HandPump pump, List<string> modes)
        {
            _link = link;
            _pump = pump;
            _modes = modes;
            // Requests wait for their answers, and the hand stays in view meanwhile.
            new Thread(() => { while (true) { Give(); Thread.Sleep(11); } }) { IsBackground = true }.Start();
        }

        public void Wait(double spanS)
        {
            Thread.Sleep((int)(1000.0 * spanS));
        }

        public void Until(string what, Predicate<Twin> holds)
        {
            double endS = HandLink.NowS + PatienceS;
            while (_link.Twin == null || !holds(_link.Twin))
            {
                if (HandLink.NowS > endS)
                {
                    Twin twin = _link.Twin;
                    throw new TimeoutException(
                        "no " + what + "; " + (twin == null ? _link.Reason : twin.Mode + ": " + twin.Reason));
                }
                Wait(0.005);
            }
        }

        private void Give()
        {
            _pump.Give(new HandPose(PositionM, Clutch, true));
            Twin twin = _link.Twin;
            if (twin != null && (_modes.Count == 0 || _modes[_modes.Count - 1] != twin.Mode))
            {
                _modes.Add(twin.Mode);
            }
        }
    }
}
